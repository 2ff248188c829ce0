"""How far objects reach: what pushes, drops and stacks are aimed by."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.sim import Simulator

__all__ = ["Extents"]


class Extents:
    """Bounding boxes of a simulator's entities, read once an episode."""

    def __init__(self, simulator: Simulator) -> None:
        meshes = simulator.meshes()
        self._corners: Mapping[str, np.ndarray] = {n: _corners(mesh.bounds) for n, mesh in meshes.items()}

    def corners(self, name: str, pose: np.ndarray) -> np.ndarray:
        """Corners (8, 3) of an entity's box at a pose (7,), metres."""
        return pose[:3] + Rotation.from_quat(pose[3:], scalar_first=True).apply(self._corners[name])

    def height(self, name: str, pose: np.ndarray) -> tuple[float, float]:
        """Lowest and highest z of an entity at a pose (7,)."""
        z = self.corners(name, pose)[:, 2]
        return float(z.min()), float(z.max())

    def reach(self, name: str, pose: np.ndarray, direction: np.ndarray) -> float:
        """How far from its origin an entity at a pose (7,) reaches along a unit vector (3,), metres."""
        return float(((self.corners(name, pose) - pose[:3]) @ direction).max())

    def radius(self, name: str) -> float:
        """Largest distance of an entity's corners from its origin, metres."""
        return float(np.linalg.norm(self._corners[name], axis=1).max())


def _corners(bounds: np.ndarray) -> np.ndarray:
    """Corners (8, 3) of the box between ``bounds`` (2, 3)."""
    return np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i, j, k in product((0, 1), repeat=3)])
