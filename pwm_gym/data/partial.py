"""What one camera sees of recorded episodes: the partial clouds that the paper's baselines learn from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from pwm_gym.data.dataset import Dataset, Windows
from pwm_gym.dynamics.training import Batch
from pwm_gym.errors import DatasetError
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sensing import DepthCamera, RayCaster

if TYPE_CHECKING:
    import trimesh

__all__ = ["CAMERA", "PARTIAL_POINTS", "PartialWindows", "choose_visible", "visibility"]

CAMERA = DepthCamera.looking((1.15, -0.55, 0.65), (0.6, 0.0, 0.15), fov=50.0)
"""In front of a table-top robot, to its right, looking down at its work area."""


PARTIAL_POINTS = 64
"""Points of each entity in a partial cloud."""


def visibility(
    dataset: Dataset,
    meshes: Mapping[str, trimesh.Trimesh],
    camera: DepthCamera = CAMERA,
    cache: Path | None = None,
    progress: bool = True,
) -> np.ndarray:
    """Which canonical points the camera sees in each frame of each episode, bool (F, N), episode after episode.

    Args:
        dataset: a split.
        meshes: the entities' surfaces, which hide points.
        camera: looks.
        cache: a file to keep the answer in, and to read it from.
        progress: whether to show a bar.

    Raises:
        DatasetError: the file holds another data set's.
    """
    frames, points = sum(len(e) + 1 for e in dataset.episodes), dataset.layout.points
    if cache is not None and cache.exists():
        with np.load(cache, allow_pickle=False) as file:
            seen = np.unpackbits(file["visible"], axis=1, count=points).astype(bool)
        if len(seen) != frames:
            raise DatasetError(f"{cache} tells of {len(seen)} frames; expected {frames}")
        return seen
    caster = RayCaster(meshes, dataset.layout)
    rows = []
    for episode in tqdm(dataset.episodes, disable=not progress, desc="visibility", leave=False):
        for poses in matrix_from_pose7(torch.as_tensor(episode.poses, dtype=torch.float64)).numpy():
            placed = [
                dataset.clouds[e.slice] @ pose[:3, :3].T + pose[:3, 3]
                for e, pose in zip(dataset.layout, poses, strict=True)
            ]
            rows.append(caster.visible(camera, np.concatenate(placed), poses))
    seen = np.stack(rows)
    if cache is not None:
        cache.parent.mkdir(parents=True, exist_ok=True)
        with cache.open("wb") as file:
            np.savez_compressed(file, visible=np.packbits(seen, axis=1))
    return seen


def choose_visible(seen: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Indices (B, count) of points drawn among those seen (B, n), each as often as any other.

    Fewer visible points than ``count`` are repeated; where none is, all count as seen (the entity's last known cloud).
    """
    seen = seen | ~seen.any(1, keepdim=True)
    order = (seen.float() + 0.5 * torch.rand(seen.shape, generator=generator)).argsort(1, descending=True)
    place = torch.arange(count) % seen.sum(1, keepdim=True)
    return order.gather(1, place)


class PartialWindows(Windows):
    """Windows whose clouds are what a camera sees: ``points`` of each entity, repeated where fewer are seen.

    The same points are followed through a window (their velocities are inputs, as in the paper); the targets of a loss
    without correspondences are drawn afresh in each frame.

    Args:
        dataset: a split.
        seen: visible points (F, N) of :func:`visibility`.
        points: points of each entity.
        boost: as in :class:`~pwm_gym.data.Windows`.
    """

    def __init__(self, dataset: Dataset, seen: np.ndarray, points: int = PARTIAL_POINTS, boost: float = 1.0) -> None:
        super().__init__(dataset, boost)
        self._seen, self._points, self._full = torch.as_tensor(seen), points, dataset.layout
        self.layout = dataset.layout.truncate(points)

    def at(self, frames: Tensor, horizon: int, generator: torch.Generator) -> Batch:
        """The windows (B,) that begin at ``frames``; ``generator`` draws the points."""
        whole = super().at(frames, horizon, generator)
        targets = []
        for h in range(horizon):
            canonical = self._partial(frames + 1 + h, generator)
            parts = [
                canonical[:, e.slice] @ pose[:, :3, :3].transpose(1, 2) + pose[:, None, :3, 3]
                for e, pose in zip(self.layout, whole.following[:, h].unbind(1), strict=True)
            ]
            targets.append(torch.cat(parts, 1))
        return replace(whole, clouds=self._partial(frames, generator), observed=torch.stack(targets, 1))

    def _partial(self, frames: Tensor, generator: torch.Generator) -> Tensor:
        """Canonical points (B, n, 3) that are visible in ``frames`` (B,)."""
        seen, parts = self._seen[frames], []
        for full, e in zip(self._full, self.layout, strict=True):
            index = full.start + choose_visible(seen[:, full.slice], e.points, generator)
            parts.append(self._clouds[index])
        return torch.cat(parts, 1)
