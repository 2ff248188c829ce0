"""The viewer's frame: where the completion network works."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError

__all__ = ["LEAST", "ViewerFrame"]

LEAST = 32
"""Fewest points of a partial cloud that are completed."""
_COARSE = 64  # points that tell a cloud's middle and size, however unevenly it is sampled


@dataclass(frozen=True, eq=False)
class ViewerFrame:
    """Origin in the middle of the partial cloud, z away from the camera, the cloud's size as unit."""

    rotation: np.ndarray
    """(3, 3): its axes in the robot base's frame, as columns."""
    centre: np.ndarray
    """(3,): its origin in the base's frame, metres."""
    size: float
    """Its unit in metres: the farthest point's distance from the middle."""

    @classmethod
    def of(cls, partial: np.ndarray, eye: np.ndarray) -> ViewerFrame:
        """Frame of a partial cloud (m, 3) in the order of farthest-point sampling, seen from ``eye`` (3,).

        Only the partial cloud decides it (paper, appendix).

        Raises:
            PwmGymError: the camera is inside the cloud, or the cloud is one point.
        """
        coarse = partial[:_COARSE].astype(np.float64)
        centre = coarse.mean(0)
        size = float(np.linalg.norm(coarse - centre, axis=1).max())
        forward = centre - np.asarray(eye, np.float64)
        distance = float(np.linalg.norm(forward))
        if not 1e-6 < size < distance:
            raise PwmGymError(
                f"a partial cloud of radius {size:.3g} m seen from {distance:.3g} m; expected the camera outside"
            )
        forward /= distance
        side = np.cross(forward, np.eye(3)[np.abs(forward).argmin()])
        side /= np.linalg.norm(side)
        return cls(np.stack([side, np.cross(forward, side), forward], 1), centre, size)

    def turn(self, angle: float) -> ViewerFrame:
        """The same frame, turned by ``angle`` (radians) about the line of sight."""
        about = Rotation.from_euler("z", angle).as_matrix()
        return ViewerFrame(self.rotation @ about, self.centre, self.size)

    def enter(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the base's frame in this one, float32."""
        return ((points - self.centre) @ self.rotation / self.size).astype(np.float32)

    def leave(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of this frame in the base's, float32 metres."""
        return (points.astype(np.float64) * self.size @ self.rotation.T + self.centre).astype(np.float32)
