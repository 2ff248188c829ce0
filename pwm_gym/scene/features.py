"""Small vectors that describe a state: for policies that do not read points."""

from __future__ import annotations

import torch
from torch import Tensor

from pwm_gym.scene.state import State

__all__ = ["POSE_FEATURES", "pose_features"]

POSE_FEATURES = 12
"""Values an entity: position (3), two columns of its rotation (6), velocity of its origin (3, metres a step)."""


def pose_features(state: State, goal: Tensor) -> Tensor:
    """Features (B, 12 E + G) of states (B,) and goals (B, G), in the base's frame."""
    frames = state.history()
    now, before = frames[:, 0], frames[:, 1]
    rotation = now[..., :3, :2].flatten(-2)  # (B, E, 6)
    parts = torch.cat([now[..., :3, 3], rotation, now[..., :3, 3] - before[..., :3, 3]], -1)
    return torch.cat([parts.flatten(1), goal], 1)
