"""A collected data set in memory, and the windows that training draws from it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pwm_gym.data.episodes import KINDS, Episode, read_shard
from pwm_gym.dynamics.training import Batch
from pwm_gym.errors import DatasetError, unknown_name
from pwm_gym.scene import Layout, Scene
from pwm_gym.scene.se3 import matrix_from_pose7

__all__ = ["SPLITS", "Dataset", "Windows", "load_split", "read_header"]

SPLITS = ("train", "validation", "test")
_SCHEMA = 1
_STILL = 1e-3  # metres a step; an object that moves more, and not with the hand, is an event


@dataclass(frozen=True)
class Dataset:
    """Episodes of one split and the canonical clouds that they share."""

    task: str
    layout: Layout
    clouds: np.ndarray
    """(N, 3) float32."""
    episodes: tuple[Episode, ...]

    def of_kinds(self, kinds: Sequence[str]) -> Dataset:
        """Only the episodes of these kinds."""
        for kind in kinds:
            if kind not in KINDS:
                raise unknown_name("kind of episode", kind, KINDS)
        chosen = {KINDS.index(kind) for kind in kinds}
        kept = tuple(e for e in self.episodes if e.kind in chosen)
        return Dataset(self.task, self.layout, self.clouds, kept)

    def scene(self, episode: Episode, step: int = 0) -> Scene:
        """The scene at ``step`` of ``episode``, velocities included."""
        frames = [max(step - k, 0) for k in range(3)]
        return Scene(
            task=self.task,
            layout=self.layout,
            clouds=self.clouds,
            poses=episode.poses[frames].astype(np.float64),
            goal=episode.goal,
            joints=episode.joints[step],
            last_action=episode.actions[step - 1] if step else None,
        )


def read_header(folder: Path, task: str | None = None) -> dict[str, object]:
    """The data set's description.

    Raises:
        DatasetError: no data set is there, or one of another task or a newer schema.
    """
    path = Path(folder) / "dataset.json"
    if not path.exists():
        raise DatasetError(f"{folder} is not a data set: it has no dataset.json")
    try:
        header = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise DatasetError(f"{path} is truncated or not JSON ({error})") from error
    if header.get("format") != "pwm_gym.dataset":
        raise DatasetError(f"{path} has format {header.get('format')!r}; expected 'pwm_gym.dataset'")
    if header["schema"] > _SCHEMA:
        raise DatasetError(f"{path} has schema {header['schema']}; this version reads up to {_SCHEMA}")
    found = header["settings"]["task"]
    if task is not None and found != task:
        raise DatasetError(f"{folder} is a data set of task {found!r}; expected {task!r}")
    return header


def load_split(folder: Path | str, split: str, task: str | None = None) -> Dataset:
    """Every episode of ``split`` ("train", "validation" or "test") below ``folder``."""
    if split not in SPLITS:
        raise unknown_name("split", split, SPLITS)
    header = read_header(Path(folder), task)
    name = header["settings"]["task"]  # type: ignore[index]
    paths = sorted(Path(folder).glob(f"{split}-*.npz"))
    if not paths:
        raise DatasetError(f"{folder} has no episodes of split {split!r} yet")
    episodes = [episode for path in paths for episode in read_shard(path, name)]
    layout = Layout.from_json(header["layout"])  # type: ignore[arg-type]
    return Dataset(name, layout, np.asarray(header["clouds"], np.float32), tuple(episodes))


class Windows:
    """Random windows of H steps with three poses of history; a pure function of the generator's seed.

    Args:
        dataset: a split.
        boost: how much likelier a window is drawn in which an object moves, but not with the end effector
            (pushes, drops and releases: rare, and most of an object's error).
    """

    def __init__(self, dataset: Dataset, boost: float = 1.0) -> None:
        poses = [torch.as_tensor(e.poses, dtype=torch.float64) for e in dataset.episodes]
        self._poses = matrix_from_pose7(torch.cat(poses)).float()  # (F, E, 4, 4)
        self._joints = torch.cat([torch.as_tensor(e.joints) for e in dataset.episodes])
        self._actions = torch.cat([torch.as_tensor(np.r_[e.actions, e.actions[-1:]]) for e in dataset.episodes])
        self._clouds = torch.as_tensor(dataset.clouds)
        self.layout = dataset.layout
        lengths = np.array([len(e) for e in dataset.episodes])
        starts = np.concatenate([[0], np.cumsum(lengths + 1)[:-1]])
        self._first = torch.as_tensor(np.repeat(starts, lengths + 1))  # of each frame's episode
        last = np.repeat(starts + lengths, lengths + 1)
        self._left = torch.as_tensor(last) - torch.arange(len(last))  # transitions after each frame
        self._events = torch.cat([torch.zeros(1), self._event_steps(dataset.layout).cumsum(0)])
        self._boost = boost
        self._tables: dict[int, tuple[Tensor, Tensor]] = {}

    def __len__(self) -> int:
        return int((self._left > 0).sum())

    def _event_steps(self, layout: Layout) -> Tensor:
        """1.0 (F,) where an object moves on its own in the step after the frame."""
        position = self._poses[:, :, :3, 3]
        move = torch.zeros_like(position)
        move[:-1] = position[1:] - position[:-1]
        objects = [i for i, e in enumerate(layout) if not e.effector]
        own = move[:, objects].norm(dim=-1)
        relative = (move[:, objects] - move[:, layout.root, None]).norm(dim=-1)
        return ((torch.minimum(own, relative) > _STILL).any(1) & (self._left > 0)).float()

    def _table(self, horizon: int) -> tuple[Tensor, Tensor]:
        """Frames that have ``horizon`` steps after them, and their cumulative weights."""
        if horizon not in self._tables:
            frames = torch.nonzero(self._left >= horizon).squeeze(1)
            if not len(frames):
                raise DatasetError(f"no episode is {horizon} steps long")
            eventful = (self._events[frames + horizon] - self._events[frames]) > 0
            weights = 1.0 + (self._boost - 1.0) * eventful.double()
            self._tables[horizon] = frames, weights.cumsum(0)
        return self._tables[horizon]

    def sample(self, generator: torch.Generator, batch: int, horizon: int) -> Batch:
        """``batch`` windows of ``horizon`` steps."""
        frames, cumulative = self._table(horizon)
        draw = torch.rand(batch, generator=generator, dtype=torch.float64) * cumulative[-1]
        chosen = frames[torch.searchsorted(cumulative, draw).clamp_max(len(frames) - 1)]
        return self.at(chosen, horizon, generator)

    def transitions(self) -> Batch:
        """Every single step of the data set, as windows of one."""
        return self.at(torch.nonzero(self._left > 0).squeeze(1), 1, torch.Generator().manual_seed(0))

    def chunks(self, size: int) -> Iterator[Batch]:
        """The same, ``size`` at a time."""
        for frames in torch.nonzero(self._left > 0).squeeze(1).split(size):
            yield self.at(frames, 1, torch.Generator().manual_seed(0))

    def at(self, frames: Tensor, horizon: int, generator: torch.Generator) -> Batch:
        """The windows (B,) that begin at ``frames``; ``generator`` draws what a kind of windows leaves to chance."""
        history = torch.maximum(frames[:, None] - torch.arange(3), self._first[frames][:, None])
        ahead = frames[:, None] + torch.arange(horizon + 1)
        return Batch(
            layout=self.layout,
            clouds=self._clouds.expand(len(frames), -1, -1),
            frames=self._poses[history],
            actions=self._actions[ahead[:, :-1]],
            following=self._poses[ahead[:, 1:]],
            joints=self._joints[frames],
            following_joints=self._joints[ahead[:, 1:]],
        )
