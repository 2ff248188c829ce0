"""World models that predict a velocity for each point: the paper's network and the paper's baselines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from pwm_gym.robots import Control
from pwm_gym.scene import Layout, PointState, RigidState, State
from pwm_gym.scene.joint import JOINT_KINDS

__all__ = ["PointwiseConfig", "PointwiseModel", "velocity_head"]


@dataclass(frozen=True)
class PointwiseConfig:
    """What per-point models share."""

    rigid: bool = False
    """Whether each entity moves as the rigid body that fits its points' predicted motion best (not in the paper)."""
    points: int = 0
    """Points of each entity, its cloud's first, that a rigid model reads, and that any is trained on; 0 is all. A model
    that is not rigid moves all the points it is given, as well as it can where they are more than it was trained on."""
    entity_features: bool = False
    """Whether a point's features tell its entity (ParticleFormer's instance segmentation): one-hot for the links and
    for kinds of joints, and where the point is in its entity, so that objects may have any number and order."""
    position_scale: float = 0.1
    """Metres that the network sees as 1."""
    velocity_scale: float = 0.01
    """Metres a step that the network sees, and gives, as 1."""


class PointwiseModel(nn.Module, ABC):
    """Velocities of the next step from [x_t, v_t, v_{t-1}] and an action (paper, section 3).

    The network sees distances to the mean of the end effectors' points, except that the height feature stays that of
    the robot base's frame: table and gravity depend on it.

    Args:
        layout: entities of a scene; those that the robot drives are what the model belongs to.
        control: what the action's components mean.
        config: hyper-parameters.
    """

    def __init__(self, layout: Layout, control: Control | None, config: Any) -> None:
        super().__init__()
        self.links, self.control, self.config = layout.robot(), control or Control(), config
        self.action_size = self.control.size

    @property
    def channels(self) -> int:
        """Features a point."""
        return 9 + (len(self.links) + len(JOINT_KINDS) + 6 if self.config.entity_features else 0)

    @property
    def read_points(self) -> int:
        """Points of each entity that it reads; 0 is all."""
        return int(self.config.points)

    @property
    def moved_points(self) -> int:
        """Points of each entity that it was trained to move; 0 is all, or none where entities move rigidly."""
        return 0 if self.config.rigid else int(self.config.points)

    @abstractmethod
    def network(self, rows: Tensor, positions: Tensor, action: Tensor) -> Tensor:
        """Scaled velocities (B, N, 3).

        Args:
            rows: features (B, N, C).
            positions: points (B, N, 3) as seen from the end effectors' mean, metres.
            action: (B, A) in [-1, 1].
        """

    def prepare(self, state: State) -> State:
        """The state as points, or as poses where entities are to move rigidly."""
        if self.config.rigid:
            return RigidState(state.layout, state.clouds, state.history())
        return PointState.of(state)

    def step(self, state: State, action: Tensor) -> State:
        """State (B,) one control step after ``action`` (B, A) in [-1, 1]."""
        if isinstance(state, PointState):
            return state.advance(state.points() + self._velocities(state, action))
        assert isinstance(state, RigidState)
        read = state.coarsen(state.layout.truncate(self.config.points)) if self.config.points else state
        after = read.points() + self._velocities(read, action)
        fitted = PointState(read.layout, read.clouds, after.unsqueeze(1).expand(-1, 3, -1, -1))
        return state.advance(fitted.poses())

    def forward(
        self,
        points: Tensor,
        velocity: Tensor,
        previous_velocity: Tensor,
        action: Tensor,
        layout: Layout,
    ) -> Tensor:
        """Velocities of the next step (B, N, 3) in metres a step.

        Args:
            points: x_t (B, N, 3) in metres.
            velocity: v_t (B, N, 3) in metres a step.
            previous_velocity: v_{t-1} (B, N, 3).
            action: a_t (B, A) in [-1, 1].
            layout: of these points.
        """
        positions = points - _effector_mean(points, layout)
        height = points[..., 2:] / self.config.position_scale
        motion = torch.cat([velocity, previous_velocity], -1) / self.config.velocity_scale
        rows = torch.cat([positions[..., :2] / self.config.position_scale, height, motion], -1)
        if self.config.entity_features:
            rows = torch.cat([rows, self._of_entities(points, layout)], -1)
        return self.network(rows, positions, action) * self.config.velocity_scale

    def _of_entities(self, points: Tensor, layout: Layout) -> Tensor:
        """What each point's features tell of its entity (B, N, K)."""
        names, told = self.links.names, []
        for e in layout:
            own = points[:, e.slice]
            offset, size = own - own.mean(1, keepdim=True), own.amax(1, keepdim=True) - own.amin(1, keepdim=True)
            place = names.index(e.name) if e.driven else len(names) + JOINT_KINDS.index(e.joint.kind)
            hot = points.new_zeros(len(names) + len(JOINT_KINDS))
            hot[place] = 1.0
            shape = torch.cat([offset, size.expand_as(offset)], -1) / self.config.position_scale
            told.append(torch.cat([hot.expand(*own.shape[:2], -1), shape], -1))
        return torch.cat(told, 1)

    def _velocities(self, state: State, action: Tensor) -> Tensor:
        return self(state.points(), state.velocity(), state.previous_velocity(), action, state.layout)


def _effector_mean(points: Tensor, layout: Layout) -> Tensor:
    """Mean (B, 1, 3) of the end effectors' points, or of all where there is no end effector."""
    parts = [points[:, e.slice] for e in layout if e.driven] or [points]
    # In float64 the mean does not depend on the order of the points, and so neither do their cells.
    return torch.cat(parts, 1).double().mean(1, keepdim=True).to(points.dtype)


def velocity_head(size: int, layers: int) -> nn.Sequential:
    """Layer norm and an MLP (..., size) to (..., 3); its first outputs are small: untrained, little moves."""
    hidden = [m for _ in range(layers - 1) for m in (nn.Linear(size, size), nn.GELU())]
    last = nn.Linear(size, 3)
    nn.init.normal_(last.weight, std=1e-2)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.LayerNorm(size), *hidden, last)
