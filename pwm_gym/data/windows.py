"""Random windows of recorded episodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from pwm_gym.data.batch import Batch, Batches
from pwm_gym.data.dataset import Dataset
from pwm_gym.errors import DatasetError
from pwm_gym.scene import Layout
from pwm_gym.scene.cloud import reordered
from pwm_gym.scene.se3 import matrix_from_pose7

__all__ = ["Windows", "mixed"]

_LEADING = 256  # points of an entity that an order begins with: all that a model reads of a rigid body
_STILL = 1e-3  # metres a step; an object that moves more, and not with the hand, is an event


class Windows:
    """Random windows of H steps with three poses of history; a pure function of the generator's seed.

    Args:
        dataset: a split.
        boost: how much likelier a window is drawn in which an object moves, but not with the end effector
            (pushes, drops and releases: rare, and most of an object's error); where several objects do so in one step
            (one pushes another: rarer still), as much again.
        orders: of each cloud's points, among which :meth:`sample` draws. Models read an entity's first points; with a
            single order they would learn the motion of those few, and not know the same shape sampled anew.

    Raises:
        DatasetError: less than one order.
    """

    def __init__(self, dataset: Dataset, boost: float = 1.0, orders: int = 1) -> None:
        if orders < 1:
            raise DatasetError(f"orders={orders}; expected at least 1")
        poses = [torch.as_tensor(e.poses, dtype=torch.float64) for e in dataset.episodes]
        self._poses = matrix_from_pose7(torch.cat(poses)).float()  # (F, E, 4, 4)
        self._joints = torch.cat([torch.as_tensor(e.joints) for e in dataset.episodes])
        self._actions = torch.cat([torch.as_tensor(np.r_[e.actions, e.actions[-1:]]) for e in dataset.episodes])
        self._clouds = torch.as_tensor(_ordered(dataset, orders))  # (O K, N, 3), the first K as they are stored
        self._orders, self._combinations = orders, len(dataset.clouds)
        self.layout = dataset.layout
        lengths = np.array([len(e) for e in dataset.episodes])
        starts = np.concatenate([[0], np.cumsum(lengths + 1)[:-1]])
        self._combination = torch.as_tensor(np.repeat(dataset.combination_of, lengths + 1))  # of each frame
        self._first = torch.as_tensor(np.repeat(starts, lengths + 1))  # of each frame's episode
        last = np.repeat(starts + lengths, lengths + 1)
        self._left = torch.as_tensor(last) - torch.arange(len(last))  # transitions after each frame
        moving = self._moving_alone(dataset.layout)
        self._events = [torch.cat([torch.zeros(1), (moving >= least).float().cumsum(0)]) for least in (1, 2)]
        self._boost = boost
        self._tables: dict[int, tuple[Tensor, Tensor]] = {}

    def __len__(self) -> int:
        return int((self._left > 0).sum())

    @property
    def longest(self) -> int:
        """Steps of the longest episode."""
        return int(self._left.max())

    def _moving_alone(self, layout: Layout) -> Tensor:
        """Number (F,) of objects that move on their own in the step after the frame."""
        position = self._poses[:, :, :3, 3]
        move = torch.zeros_like(position)
        move[:-1] = position[1:] - position[:-1]
        objects = [*layout.loose, *layout.articulated]
        motion = move[:, objects]
        own = motion.norm(dim=-1)
        for hand in layout.hands:  # what moves as a hand does is carried by it
            own = torch.minimum(own, (motion - move[:, hand, None]).norm(dim=-1))
        return (own > _STILL).sum(1) * (self._left > 0)

    def _table(self, horizon: int) -> tuple[Tensor, Tensor]:
        """Frames that have ``horizon`` steps after them, and their cumulative weights."""
        if horizon not in self._tables:
            frames = torch.nonzero(self._left >= horizon).squeeze(1)
            if not len(frames):
                raise DatasetError(f"no episode is {horizon} steps long")
            kinds = [(events[frames + horizon] - events[frames]) > 0 for events in self._events]
            weights = self._boost ** torch.stack(kinds).double().sum(0)
            self._tables[horizon] = frames, weights.cumsum(0)
        return self._tables[horizon]

    def sample(self, generator: torch.Generator, batch: int, horizon: int) -> Batch:
        """``batch`` windows of ``horizon`` steps."""
        frames, cumulative = self._table(horizon)
        draw = torch.rand(batch, generator=generator, dtype=torch.float64) * cumulative[-1]
        chosen = frames[torch.searchsorted(cumulative, draw).clamp_max(len(frames) - 1)]
        if self._orders == 1:
            return self.at(chosen, horizon, generator)
        order = torch.randint(self._orders, (batch,), generator=generator)
        return self._cut(chosen, horizon, order * self._combinations + self._combination[chosen])

    def transitions(self) -> Batch:
        """Every single step of the data set, as windows of one."""
        return self.at(torch.nonzero(self._left > 0).squeeze(1), 1, torch.Generator().manual_seed(0))

    def chunks(self, size: int) -> Iterator[Batch]:
        """The same, ``size`` at a time."""
        for frames in torch.nonzero(self._left > 0).squeeze(1).split(size):
            yield self.at(frames, 1, torch.Generator().manual_seed(0))

    def at(self, frames: Tensor, horizon: int, generator: torch.Generator) -> Batch:
        """The windows (B,) that begin at ``frames``; ``generator`` draws what a kind of windows leaves to chance."""
        return self._cut(frames, horizon, self._combination[frames])

    def _cut(self, frames: Tensor, horizon: int, clouds: Tensor) -> Batch:
        """The windows (B,) that begin at ``frames``, with the canonical points at places ``clouds`` (B,)."""
        history = torch.maximum(frames[:, None] - torch.arange(3), self._first[frames][:, None])
        ahead = frames[:, None] + torch.arange(horizon + 1)
        return Batch(
            layout=self.layout,
            clouds=self._clouds[clouds],
            frames=self._poses[history],
            actions=self._actions[ahead[:, :-1]],
            following=self._poses[ahead[:, 1:]],
            joints=self._joints[frames],
            following_joints=self._joints[ahead[:, 1:]],
        )


def _ordered(dataset: Dataset, orders: int) -> np.ndarray:
    """Canonical points (O K, N, 3) of the K combinations of assets in the data set's order, then in others."""
    rng, clouds = np.random.default_rng(0), dataset.clouds
    anew = [
        np.concatenate([reordered(points[e.slice], int(rng.integers(e.points)), _LEADING) for e in dataset.layout])
        for _ in range(orders - 1)
        for points in clouds
    ]
    return np.stack([*clouds, *anew]).astype(np.float32)


class _Mixed:
    """Windows of several data sets; each batch is of one of them."""

    def __init__(self, sources: Sequence[Windows]) -> None:
        self._sources = sources

    def sample(self, generator: torch.Generator, batch: int, horizon: int) -> Batch:
        """``batch`` windows of ``horizon`` steps, of a source that is drawn evenly."""
        place = int(torch.randint(len(self._sources), (), generator=generator))
        return self._sources[place].sample(generator, batch, horizon)


def mixed(sources: Sequence[Windows]) -> Batches:
    """Windows of all ``sources``, evenly; each batch is of one layout."""
    return sources[0] if len(sources) == 1 else _Mixed(sources)
