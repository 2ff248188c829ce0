"""What a policy network reads: where entities are, seen from the hand, and their points."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from pwm_gym.scene import POSE_FEATURES

__all__ = ["EntityFeatures", "PointFeatures"]

_PLACE, _SPEED = 10.0, 50.0  # what metres, and metres a step, are multiplied by
_NEAR = 0.02  # metres: the finer scale of ways between entities
_CHANNELS = 64  # of a point, and of what is told of all of an entity's


class EntityFeatures(BaseFeaturesExtractor):
    """Poses (B, 12 E + G), places seen from the hand; goals seen from the hand and from each loose object.

    Loose objects are seen from each other, and from the hand, on a finer scale, too: whether one is on another, or
    between fingers, is a matter of millimetres.

    Args:
        observation_space: of :class:`pwm_gym.wrappers.EntityPoses`.
        hand: place among the entities of the one that the others are seen from.
        objects: places of the loose ones.
        goal_size: G; only goals of three values are places.
    """

    def __init__(
        self, observation_space: gym.spaces.Box, hand: int = 0, objects: Sequence[int] = (), goal_size: int = 0
    ) -> None:
        entities = (observation_space.shape[0] - goal_size) // POSE_FEATURES
        placed = goal_size == 3
        pairs = [*combinations((hand, *objects), 2)]
        told = placed * 3 * (1 + len(objects)) + 6 * len(pairs)
        super().__init__(observation_space, POSE_FEATURES * entities + goal_size + told)
        self.entities, self.hand, self.objects, self.placed = entities, hand, [*objects], placed
        self._from, self._to = ([pair[k] for pair in pairs] for k in (0, 1))

    def forward(self, observations: Tensor) -> Tensor:
        """Features (B, F)."""
        own = observations[:, : POSE_FEATURES * self.entities].unflatten(1, (self.entities, POSE_FEATURES))
        goal = observations[:, POSE_FEATURES * self.entities :]
        places, turns, speeds = own.split([3, POSE_FEATURES - 6, 3], -1)
        parts = [_seen_from(places, self.hand).flatten(1), turns.flatten(1), speeds.flatten(1) * _SPEED, goal]
        ways = (places[:, self._to] - places[:, self._from]).flatten(1)
        parts += [ways * _PLACE, torch.tanh(ways / _NEAR)]
        if self.placed:
            parts += [(goal - places[:, k]) * _PLACE for k in (self.hand, *self.objects)]
        return torch.cat(parts, 1)


class PointFeatures(BaseFeaturesExtractor):
    """A PointNet over each entity's points and velocities, with the goal: Dict of points to features (B, F).

    Args:
        observation_space: Dict of points, velocity, previous_velocity (N, 3) and goal (G,).
        counts: points of each entity, in order.
        hand: place among the entities of the one that all is seen from.
    """

    def __init__(self, observation_space: gym.spaces.Dict, counts: Sequence[int], hand: int = 0) -> None:
        goal = int(observation_space["goal"].shape[0])  # type: ignore[index]
        super().__init__(observation_space, (_CHANNELS + 3) * len(counts) + goal)
        self.counts, self.hand = [*counts], hand
        self.lift = nn.Sequential(nn.Linear(6 + len(counts), _CHANNELS), nn.GELU(), nn.Linear(_CHANNELS, _CHANNELS))
        which = torch.eye(len(counts)).repeat_interleave(torch.tensor(self.counts), 0)
        self.register_buffer("which", which, persistent=False)

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Features (B, F): of each entity the greatest of its points' channels and its centre, then the goal."""
        points = observations["points"]
        centres = torch.stack([part.mean(1) for part in points.split(self.counts, 1)], 1)
        origin = centres[:, self.hand, None]
        which: Any = self.which
        own = torch.cat([(points - origin) * _PLACE, observations["velocity"] * _SPEED], -1)
        lifted = self.lift(torch.cat([own, which.expand(len(points), -1, -1)], -1))
        told = torch.stack([part.amax(1) for part in lifted.split(self.counts, 1)], 1)
        return torch.cat([told.flatten(1), _seen_from(centres, self.hand).flatten(1), observations["goal"]], 1)


def _seen_from(places: Tensor, hand: int) -> Tensor:
    """Scaled ways (B, E, 3) from the hand to places (B, E, 3), metres; its own place stands where it is."""
    origin = places[:, hand : hand + 1]
    ways = (places - origin) * _PLACE
    return torch.cat([ways[:, :hand], origin, ways[:, hand + 1 :]], 1)
