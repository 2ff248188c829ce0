"""The batched state of a scene: its points and their two last velocities.

Rigid scenes keep entity poses of three steps and form points only when asked (:class:`RigidState`); a deformable or
unsegmented scene keeps the points themselves (:class:`PointState`). Every array may have any leading dimensions:
(B,) in an environment, (B, H) for a rollout.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from pwm_gym.errors import UnknownEntityError
from pwm_gym.scene.layout import Layout
from pwm_gym.scene.se3 import make_pose, transform

__all__ = ["EntityPoints", "PointState", "RigidState", "State", "stack"]


@runtime_checkable
class State(Protocol):
    """What a world model moves: x_t, v_t = x_t - x_{t-1} and v_{t-1}, in metres and metres per step."""

    @property
    def layout(self) -> Layout:
        """The entities, in the order of their points."""

    @property
    def clouds(self) -> Tensor:
        """Canonical points (..., N, 3)."""

    @property
    def frames(self) -> Tensor:
        """The tensor that moves: three steps of it, newest first."""

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """Every batched tensor, in the order in which :meth:`map` takes them."""

    @property
    def batch(self) -> torch.Size:
        """Leading dimensions."""

    def points(self, step: int = 0) -> Tensor:
        """World-frame points (..., N, 3), ``step`` (0, 1 or 2) steps ago."""

    def velocity(self) -> Tensor:
        """v_t (..., N, 3)."""

    def previous_velocity(self) -> Tensor:
        """v_{t-1} (..., N, 3)."""

    def motion(self) -> tuple[Tensor, Tensor, Tensor]:
        """Points, v_t and v_{t-1}, each (..., N, 3): fresh and contiguous, for whoever keeps them."""

    def entity(self, name: str, step: int = 0) -> Tensor:
        """World-frame points (..., n, 3) of one entity, ``step`` (0, 1 or 2) steps ago."""

    def poses(self) -> Tensor:
        """World-frame poses (..., E, 4, 4) of the entities."""

    def history(self) -> Tensor:
        """Poses (..., 3, E, 4, 4) of three steps, newest first."""

    def __getitem__(self, index: Any) -> State:
        """Index the leading dimensions."""

    def map(self, function: Any) -> State:
        """State with ``function`` applied to each batched tensor."""


@dataclass(frozen=True)
class RigidState:
    """Entity poses of three steps, newest first, with the canonical clouds that they carry."""

    layout: Layout
    clouds: Tensor
    """Canonical points (..., N, 3), with the same leading dimensions as the poses (expanded, not copied)."""
    frames: Tensor
    """Poses (..., 3, E, 4, 4) at t, t-1, t-2."""
    joints: Tensor | None = None
    """Robot's joint positions and velocities (..., 2, J), where they are known; radians (metres), and these a step."""
    error: Tensor | None = None
    """Expected distance (..., E) of each entity's points from the truth, metres, from models that tell."""

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """Every batched tensor, in the order in which :meth:`map` takes them."""
        return tuple(self._named().values())

    def _named(self) -> dict[str, Tensor]:
        names = ("clouds", "frames", "joints", "error")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @property
    def batch(self) -> torch.Size:
        """Leading dimensions."""
        return self.frames.shape[:-4]

    def points(self, step: int = 0) -> Tensor:
        """World-frame points (..., N, 3), ``step`` (0, 1 or 2) steps ago."""
        frames = self.frames[..., step, :, :, :]
        parts = [transform(frames[..., i, :, :], self.clouds[..., e.slice, :]) for i, e in enumerate(self.layout)]
        return torch.cat([part.transpose(-1, -2) for part in parts], -1).transpose(-1, -2)  # along the points in memory

    def velocity(self) -> Tensor:
        """v_t (..., N, 3)."""
        return self.points(0) - self.points(1)

    def previous_velocity(self) -> Tensor:
        """v_{t-1} (..., N, 3)."""
        return self.points(1) - self.points(2)

    def motion(self) -> tuple[Tensor, Tensor, Tensor]:
        """Points, v_t and v_{t-1}, each (..., N, 3), fresh and contiguous.

        Points are linear in their entity's pose, so a difference of poses moves the clouds to the velocities.
        """
        now, before, earlier = self.frames.unbind(-4)
        return self._placed(now), self._placed(now - before), self._placed(before - earlier)

    def _placed(self, poses: Tensor) -> Tensor:
        """Clouds (..., N, 3) moved by poses (..., E, 4, 4), or by differences of them: 0 where nothing moves."""
        flat, clouds = poses.reshape(-1, *poses.shape[-3:]), self.clouds.reshape(-1, *self.clouds.shape[-2:])
        moves = (flat != 0).flatten(-2).any(-1)  # (B, E)
        counts = moves.sum(0).tolist()
        placed = torch.zeros(clouds.shape, dtype=poses.dtype, device=poses.device)
        for i, entity in enumerate(self.layout):
            rows = slice(None) if counts[i] == len(flat) else moves[:, i].nonzero().squeeze(-1)
            if counts[i]:
                placed[rows, entity.slice] = transform(flat[rows, i], clouds[rows, entity.slice])
        return placed.view(*poses.shape[:-3], *placed.shape[1:])

    def entity(self, name: str, step: int = 0) -> Tensor:
        """World-frame points (..., n, 3) of one entity, ``step`` (0, 1 or 2) steps ago."""
        i = self.layout.index(name)
        return transform(self.frames[..., step, i, :, :], self.clouds[..., self.layout.entities[i].slice, :])

    def poses(self) -> Tensor:
        """World-frame poses (..., E, 4, 4)."""
        return self.frames[..., 0, :, :, :]

    def history(self) -> Tensor:
        """Poses (..., 3, E, 4, 4) of three steps, newest first."""
        return self.frames

    def advance(self, poses: Tensor, joints: Tensor | None = None, error: Tensor | None = None) -> RigidState:
        """State one step later, at ``poses`` (..., E, 4, 4); with ``joints`` (..., 2, J), ``error`` (..., E) if any."""
        frames = torch.cat([poses.unsqueeze(-4), self.frames[..., :2, :, :, :]], -4)
        return RigidState(self.layout, self.clouds, frames, joints, error)

    def __getitem__(self, index: Any) -> RigidState:
        return self.map(lambda x: x[index])

    def coarsen(self, layout: Layout) -> RigidState:
        """The same poses with the (fewer) points of ``layout``: each entity's first."""
        return replace(self, layout=layout, clouds=self.clouds[..., self.layout.kept(layout), :])

    def map(self, function: Any) -> RigidState:
        """State with ``function`` applied to each batched tensor."""
        moved: dict[str, Any] = {name: function(value) for name, value in self._named().items()}
        return replace(self, **moved)


@dataclass(frozen=True)
class PointState:
    """Points of three steps, newest first, with the canonical clouds that give entity poses by registration."""

    layout: Layout
    clouds: Tensor
    """Canonical points (..., N, 3)."""
    frames: Tensor
    """Points (..., 3, N, 3) at t, t-1, t-2."""

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """Every batched tensor, in the order in which :meth:`map` takes them."""
        return self.clouds, self.frames

    @classmethod
    def of(cls, state: State) -> PointState:
        """The same state, kept as points."""
        if isinstance(state, PointState):
            return state
        frames = torch.stack([state.points(k) for k in range(3)], -3)
        return cls(state.layout, state.clouds, frames)

    @property
    def batch(self) -> torch.Size:
        """Leading dimensions."""
        return self.frames.shape[:-3]

    def points(self, step: int = 0) -> Tensor:
        """World-frame points (..., N, 3), ``step`` (0, 1 or 2) steps ago."""
        return self.frames[..., step, :, :]

    def velocity(self) -> Tensor:
        """v_t (..., N, 3)."""
        return self.frames[..., 0, :, :] - self.frames[..., 1, :, :]

    def previous_velocity(self) -> Tensor:
        """v_{t-1} (..., N, 3)."""
        return self.frames[..., 1, :, :] - self.frames[..., 2, :, :]

    def motion(self) -> tuple[Tensor, Tensor, Tensor]:
        """Points, v_t and v_{t-1}, each (..., N, 3), fresh and contiguous."""
        points = self.points().clone(memory_format=torch.contiguous_format)
        return points, self.velocity().contiguous(), self.previous_velocity().contiguous()

    def entity(self, name: str, step: int = 0) -> Tensor:
        """World-frame points (..., n, 3) of one entity, ``step`` (0, 1 or 2) steps ago."""
        return self.frames[..., step, self.layout[name].slice, :]

    def _register(self, points: Tensor) -> Tensor:
        """Best-fitting entity poses (..., E, 4, 4) of points (..., N, 3) (Kabsch)."""
        import roma

        poses = []
        for e in self.layout:
            target = points[..., e.slice, :]
            source = self.clouds[..., e.slice, :].expand_as(target)
            poses.append(make_pose(*roma.rigid_points_registration(source, target)))
        return torch.stack(poses, -3)

    def poses(self) -> Tensor:
        """World-frame poses (..., E, 4, 4), registered to the canonical clouds."""
        return self._register(self.points())

    def history(self) -> Tensor:
        """Poses (..., 3, E, 4, 4) of three steps, newest first."""
        return torch.stack([self._register(self.frames[..., k, :, :]) for k in range(3)], -4)

    def advance(self, points: Tensor) -> PointState:
        """State one step later, at ``points`` (..., N, 3)."""
        frames = torch.cat([points.unsqueeze(-3), self.frames[..., :2, :, :]], -3)
        return PointState(self.layout, self.clouds, frames)

    def __getitem__(self, index: Any) -> PointState:
        return self.map(lambda x: x[index])

    def map(self, function: Any) -> PointState:
        """State with ``function`` applied to each batched tensor."""
        return PointState(self.layout, *map(function, self.tensors))


def stack(states: list[State], dim: int) -> State:
    """States stacked along a new leading dimension ``dim`` (a rollout stacks its steps at 1)."""
    first = states[0]
    moving = [torch.stack(tensors, dim) for tensors in zip(*(s.tensors[1:] for s in states), strict=True)]
    shape = moving[0].shape[: dim + 1] + first.clouds.shape[dim:]
    parts = iter([first.clouds.unsqueeze(dim).expand(shape), *moving])
    return first.map(lambda _: next(parts))


class EntityPoints(Mapping[str, Tensor]):
    """Entity name -> world-frame points (B, n, 3), formed when first asked for: what a cost function reads.

    In memory they run along the points, not along their coordinates: ``reshape`` them, which ``view`` cannot.

    Args:
        state: the scenes.
        velocity: whether the values are the points' velocities (metres a step) instead.
    """

    def __init__(self, state: State, velocity: bool = False) -> None:
        self._state, self._velocity = state, velocity
        self._formed: dict[str, Tensor] = {}
        self.memo: dict[Any, Any] = {}
        """What terms of a cost derive from the points, so that those that need the same form it once."""

    def __getitem__(self, name: str) -> Tensor:
        if name not in self._formed:
            if name not in self._state.layout.names:
                raise UnknownEntityError(f"no entity {name!r}; this scene has {', '.join(self._state.layout.names)}")
            points = self._state.entity(name)
            if self._velocity:
                points = points - self._state.entity(name, 1)
            elif isinstance(self._state, PointState):
                points = points.clone()  # a reader may change them; a rigid state forms them anew
            self._formed[name] = points
        return self._formed[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._state.layout.names)

    def __len__(self) -> int:
        return len(self._state.layout)
