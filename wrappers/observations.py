"""Flat observations for policies."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from pwm_gym.scene import POSE_FEATURES, pose_features

__all__ = ["EntityPoses", "FlattenPoints"]

_KEYS = ("points", "velocity", "previous_velocity", "goal")


class FlattenPoints(gym.ObservationWrapper[np.ndarray, np.ndarray, dict[str, np.ndarray]], RecordConstructorArgs):
    """Points, both velocities and the goal as one float32 vector (9 N + G,), in this order.

    Example:
        >>> env = FlattenPoints(gym.make("pwm/PickCube-v0"))
        >>> env.observation_space.shape
        (10803,)
    """

    def __init__(self, env: gym.Env[dict[str, np.ndarray], np.ndarray]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        boxes: Any = env.observation_space
        low = np.concatenate([boxes[k].low.ravel() for k in _KEYS])
        high = np.concatenate([boxes[k].high.ravel() for k in _KEYS])
        self.observation_space = gym.spaces.Box(low, high, dtype=np.float32)

    def observation(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """The vector (9 N + G,)."""
        return np.concatenate([observation[k].ravel() for k in _KEYS])


class EntityPoses(gym.ObservationWrapper[np.ndarray, np.ndarray, dict[str, np.ndarray]], RecordConstructorArgs):
    """Entities' positions, rotations (two columns) and velocities, and the goal: float32 (12 E + G,).

    Positions in metres, velocities in metres a step, in the robot base's frame.

    Example:
        >>> env = EntityPoses(gym.make("pwm/PickCube-v0"))
        >>> env.observation_space.shape
        (51,)
    """

    def __init__(self, env: gym.Env[dict[str, np.ndarray], np.ndarray]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        base: Any = env.unwrapped
        size = POSE_FEATURES * len(base.entities) + base.task.goal_size
        self.observation_space = gym.spaces.Box(-2.0, 2.0, (size,), np.float32)

    def observation(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """The vector (12 E + G,)."""
        base: Any = self.env.unwrapped
        return pose_features(base.observed_state, base.goal)[0].cpu().numpy().clip(-2.0, 2.0)
