"""Flat observations for policies."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from pwm_gym.envs.common import pose_space, poses_of
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Layout

__all__ = ["EntityPoses", "FlattenPoints", "Subsample", "at_points", "subsampled"]

_CLOUDS = ("points", "velocity", "previous_velocity")
_KEYS = (*_CLOUDS, "goal")


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
        self.observation_space = pose_space(Layout(base.entities), base.task.goal_size)

    def observation(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """The vector (12 E + G,)."""
        base: Any = self.env.unwrapped
        return np.asarray(poses_of(base.observed_state, base.goal)[0].cpu().numpy())


def subsampled(space: gym.spaces.Space[Any], layout: Layout, points: int) -> tuple[gym.spaces.Space[Any], np.ndarray]:
    """The space of observations with fewer points, and which of them stay (points,): the first of each entity's.

    Raises:
        PwmGymError: the space has no clouds of points, or not so many.
    """
    if not isinstance(space, gym.spaces.Dict) or not all(key in space.spaces for key in _CLOUDS):
        raise PwmGymError(f"Subsample needs a Dict with {', '.join(_CLOUDS)}; got {type(space).__name__}")
    kept = layout.kept(layout.resize(points))
    spaces = dict(space.spaces)
    for key in _CLOUDS:
        box: Any = space.spaces[key]
        spaces[key] = gym.spaces.Box(box.low[..., kept, :], box.high[..., kept, :], dtype=np.float32)
    return gym.spaces.Dict(spaces), kept


def at_points(observation: dict[str, Any], kept: np.ndarray) -> dict[str, Any]:
    """An observation (...) with the points at places (M,) alone."""
    return {key: value[..., kept, :] if key in _CLOUDS else value for key, value in observation.items()}


class Subsample(
    gym.ObservationWrapper[dict[str, np.ndarray], np.ndarray, dict[str, np.ndarray]], RecordConstructorArgs
):
    """Shows ``points`` points of the scene: each entity's first, in proportion to what it has.

    The world keeps all of its points: costs and the model read what they did. ``entities`` has the new slices.

    Args:
        env: environment that shows clouds.
        points: number of points of a scene in all.

    Example:
        >>> env = Subsample(gym.make("pwm/PickCube-v0"), 256)
        >>> env.observation_space["points"].shape
        (256, 3)
    """

    def __init__(self, env: gym.Env[dict[str, np.ndarray], np.ndarray], points: int) -> None:
        RecordConstructorArgs.__init__(self, points=points)
        gym.ObservationWrapper.__init__(self, env)
        base: Any = env.unwrapped
        layout = Layout(base.entities)
        self.observation_space, self._kept = subsampled(env.observation_space, layout, points)
        self.entities = layout.resize(points).entities

    def observation(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The observation with the points that stay."""
        return at_points(observation, self._kept)
