"""A small network from a scene's entity poses to an action."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Layout, RigidState

__all__ = ["Policy", "PolicyConfig", "boxes_of", "check_entities"]

_OWN = 3 + 6 + 3 + 6  # an entity's place, two of its axes, its step, and its box


@dataclass(frozen=True)
class PolicyConfig:
    """Hyper-parameters of :class:`Policy`."""

    width: int = 256
    """Hidden channels."""
    depth: int = 3
    """Hidden layers."""


def boxes_of(layout: Layout, clouds: Tensor) -> Tensor:
    """Lowest and highest corners (B, E, 6) of the entities' canonical clouds (B, N, 3), in their frames; metres."""
    parts = [clouds[:, e.slice] for e in layout]
    return torch.stack([torch.cat([part.amin(1), part.amax(1)], -1) for part in parts], 1)


def check_entities(state: RigidState, layout: Layout) -> None:
    """Raise :class:`PwmGymError` where a state has other entities than the policy's ``layout``."""
    if state.layout.names != layout.names:
        raise PwmGymError(f"the policy is of scenes of {layout.names}; this one has {state.layout.names}")


class Policy(nn.Module):
    """Actions from where entities are and go, seen from the first hand; their shapes are told by their boxes.

    Args:
        layout: entities of the scenes; a policy belongs to it.
        action_size: A.
        goal_size: G, 0 where a task has none.
        config: hyper-parameters.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self, layout: Layout, action_size: int, goal_size: int = 0, config: PolicyConfig | None = None
    ) -> None:
        super().__init__()
        self.layout, self.action_size, self.goal_size = layout, action_size, goal_size
        self.config = config or PolicyConfig()
        if min(self.config.width, self.config.depth) < 1:
            raise PwmGymError(f"width={self.config.width}, depth={self.config.depth}; expected at least 1 each")
        self.placed = goal_size == 3  # the goal is a place, then
        self.feature_size = _OWN * len(layout) + goal_size + 3 * self.placed
        sizes = [self.feature_size, *[self.config.width] * self.config.depth]
        hidden = [layer for k in range(self.config.depth) for layer in (nn.Linear(sizes[k], sizes[k + 1]), nn.GELU())]
        self.net = nn.Sequential(*hidden, nn.Linear(sizes[-1], action_size))
        self.register_buffer("mean", torch.zeros(self.feature_size))
        self.register_buffer("std", torch.ones(self.feature_size))

    def features(self, frames: Tensor, boxes: Tensor, goal: Tensor) -> Tensor:
        """Features (B, F) of scenes.

        Args:
            frames: entity poses (B, 3, E, 4, 4) at t, t-1, t-2, base frame.
            boxes: of the entities (B, E, 6), as of :func:`boxes_of`.
            goal: (B, G).
        """
        now, hands = frames[:, 0], list(self.layout.hands)
        origin = now[:, hands[0], :3, 3] if hands else now.new_zeros(len(now), 3)
        places = now[..., :3, 3] - origin.unsqueeze(1)
        if hands:
            places[:, hands[0]] = origin
        steps = now[..., :3, 3] - frames[:, 1, ..., :3, 3]
        own = torch.cat([places, now[..., :3, :2].flatten(-2), steps, boxes], -1)
        seen = [goal, goal - origin] if self.placed else [goal]
        return torch.cat([own.flatten(1), *seen], -1)

    def forward(self, features: Tensor) -> Tensor:
        """Actions (B, A) in [-1, 1] for features (B, F)."""
        return torch.tanh(self.net((features - self.mean) / self.std))

    @torch.no_grad()
    def act(self, state: RigidState, goal: Tensor) -> Tensor:
        """Actions (B, A) in states (B,) for goals (B, G).

        Raises:
            PwmGymError: a scene of other entities.
        """
        check_entities(state, self.layout)
        return self(self.features(state.frames, boxes_of(state.layout, state.clouds), goal))
