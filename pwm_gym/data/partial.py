"""What one camera sees of recorded episodes: the partial clouds that the paper's baselines learn from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from pwm_gym.cameras import DepthCamera, RayCaster
from pwm_gym.cameras.viewpoints import CAMERA
from pwm_gym.data.batch import Batch
from pwm_gym.data.dataset import Dataset, load_split, read_header
from pwm_gym.data.simulated import SceneMeshes, simulator_of
from pwm_gym.data.windows import Windows
from pwm_gym.errors import DatasetError
from pwm_gym.files import load_arrays, save_arrays
from pwm_gym.scene import Layout, Scene, batch_state
from pwm_gym.scene.se3 import matrix_from_pose7, transform
from pwm_gym.tasks import Task, get_task

if TYPE_CHECKING:
    import trimesh

__all__ = [
    "PARTIAL_POINTS",
    "PartialView",
    "PartialWindows",
    "choose_visible",
    "partial_clouds",
    "visibility",
    "visible_rows",
    "visible_split",
]

PARTIAL_POINTS = 64
"""Points of each entity in a partial cloud."""


def visibility(
    dataset: Dataset,
    meshes: Callable[[Scene], Mapping[str, trimesh.Trimesh]],
    camera: DepthCamera = CAMERA,
    cache: Path | None = None,
    progress: bool = True,
) -> np.ndarray:
    """Which canonical points the camera sees in each frame of each episode, bool (F, N), episode after episode.

    Args:
        dataset: a split.
        meshes: a scene's entities' surfaces, which hide points; asked for once a combination of assets.
        camera: looks.
        cache: a file to keep the answer in, and to read it from.
        progress: whether to show a bar.

    Raises:
        DatasetError: the file holds another data set's.
    """
    frames, points = sum(len(e) + 1 for e in dataset.episodes), dataset.layout.points
    if cache is not None and cache.exists():
        kept, _ = load_arrays(cache, "is truncated; delete it", DatasetError)
        seen = np.unpackbits(kept["visible"], axis=1, count=points).astype(bool)
        if len(seen) != frames:
            raise DatasetError(f"{cache} tells of {len(seen)} frames; expected {frames}")
        return seen
    casters: dict[tuple[str, ...], RayCaster] = {}
    rows = []
    for episode in tqdm(dataset.episodes, disable=not progress, desc="visibility", leave=False):
        if episode.assets not in casters:
            casters[episode.assets] = RayCaster(meshes(dataset.scene(episode)), dataset.layout)
        caster = casters[episode.assets]
        poses = matrix_from_pose7(torch.as_tensor(episode.poses, dtype=torch.float64))
        cloud = torch.as_tensor(dataset.cloud(episode), dtype=torch.float64)
        placed = _posed(cloud.expand(len(poses), -1, -1), dataset.layout, poses)
        rows += [caster.visible(camera, x, at) for x, at in zip(placed.numpy(), poses.numpy(), strict=True)]
    seen = np.stack(rows)
    if cache is not None:
        save_arrays(cache, {"visible": np.packbits(seen, axis=1)})
    return seen


def choose_visible(seen: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Indices (B, count) of points drawn among those seen (B, n), each as often as any other.

    Fewer visible points than ``count`` are repeated; where none is, all count as seen (the entity's last known cloud).
    """
    seen = seen | ~seen.any(1, keepdim=True)
    order = (seen.float() + 0.5 * torch.rand(seen.shape, generator=generator)).argsort(1, descending=True)
    place = torch.arange(count) % seen.sum(1, keepdim=True)
    return order.gather(1, place)


def visible_split(folder: Path, split: str, task: Task, dataset: Dataset | None = None) -> np.ndarray:
    """Points (F, N) of a data set's split that the default camera sees; worked out once, and kept beside the data set.

    Args:
        folder: of the data set.
        split: of it.
        task: gives the meshes, where they are needed.
        dataset: the split, where it is loaded already.
    """
    cache, dataset = folder / f"visible-{split}.npz", dataset or load_split(folder, split, task.name)
    if cache.exists():
        return visibility(dataset, lambda scene: {}, cache=cache)  # no mesh is needed
    with closing(simulator_of(task, dataset)) as simulator:
        return visibility(dataset, SceneMeshes(simulator), cache=cache)


def visible_rows(folders: Sequence[Path], split: str, whole: Dataset, chosen: Dataset) -> np.ndarray:
    """Points (F, N) that the default camera sees in the ``chosen`` episodes of a ``whole`` split of a task.

    Args:
        folders: of data sets; those of other tasks are passed over.
        split: of them.
        whole: its episodes, of all folders.
        chosen: some of them.
    """
    task = get_task(whole.task)
    own = [folder for folder in folders if read_header(folder).task == whole.task]
    rows = np.concatenate([visible_split(folder, split, task) for folder in own])
    episodes = np.split(rows, np.cumsum([len(e) + 1 for e in whole.episodes])[:-1])
    places = {id(e): k for k, e in enumerate(whole.episodes)}
    return np.concatenate([episodes[places[id(e)]] for e in chosen.episodes])


def partial_clouds(
    layout: Layout, clouds: Tensor, seen: Tensor, generator: torch.Generator, points: int = PARTIAL_POINTS
) -> tuple[Layout, Tensor]:
    """Canonical points (B, n, 3) drawn among those ``seen`` (B, N), and their layout.

    Args:
        layout: of ``clouds``.
        clouds: canonical points (N, 3), or (B, N, 3).
        seen: bool.
        generator: draws.
        points: of each entity, at most.
    """
    coarse = layout.truncate(points)
    clouds, parts = clouds.expand(len(seen), -1, -1), []
    for full, e in zip(layout, coarse, strict=True):
        chosen = full.start + choose_visible(seen[:, full.slice], e.points, generator)  # (B, n)
        parts.append(clouds.gather(1, chosen.unsqueeze(-1).expand(-1, -1, 3)))
    return coarse, torch.cat(parts, 1)


class PartialView:
    """What the camera sees of a scene: as :class:`PartialWindows`, for one scene at a time.

    Args:
        meshes: the entities' surfaces, which hide points.
        layout: of the scenes.
        camera: looks.
        points: points of each entity.
        seed: of the draws among the visible points.
    """

    def __init__(
        self,
        meshes: Mapping[str, trimesh.Trimesh],
        layout: Layout,
        camera: DepthCamera = CAMERA,
        points: int = PARTIAL_POINTS,
        seed: int = 0,
    ) -> None:
        self._caster, self._camera, self._points, self._seed = RayCaster(meshes, layout), camera, points, seed

    def __call__(self, scene: Scene) -> Scene:
        """The scene with points that the camera sees, the same for an equal scene.

        An entity that it does not see keeps points of all sides.
        """
        state = batch_state([scene])
        seen = self._caster.visible(self._camera, state.points()[0].double().numpy(), state.poses()[0].double().numpy())
        generator = torch.Generator().manual_seed(self._seed)
        layout, clouds = partial_clouds(
            scene.layout, torch.as_tensor(scene.clouds), torch.as_tensor(seen)[None], generator, self._points
        )
        return replace(scene, layout=layout, clouds=clouds[0].numpy())


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
        self._seen, self._points = torch.as_tensor(seen), points

    def at(self, frames: Tensor, horizon: int, generator: torch.Generator) -> Batch:
        """The windows (B,) that begin at ``frames``; ``generator`` draws the points."""
        whole = super().at(frames, horizon, generator)
        observed = []
        for h in range(horizon):
            layout, canonical = self._draw(frames + 1 + h, generator)
            observed.append(_posed(canonical, layout, whole.following[:, h]))
        layout, clouds = self._draw(frames, generator)
        return replace(whole, layout=layout, clouds=clouds, observed=torch.stack(observed, 1))

    def _draw(self, frames: Tensor, generator: torch.Generator) -> tuple[Layout, Tensor]:
        clouds = self._clouds[self._combination[frames]]
        return partial_clouds(self.layout, clouds, self._seen[frames], generator, self._points)


def _posed(canonical: Tensor, layout: Layout, poses: Tensor) -> Tensor:
    """Points (B, n, 3) of entities at ``poses`` (B, E, 4, 4), in the base's frame."""
    parts = [transform(poses[:, i], canonical[:, e.slice]) for i, e in enumerate(layout)]
    return torch.cat(parts, 1)
