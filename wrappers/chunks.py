"""Several actions a step."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from pwm_gym.errors import PwmGymError, check_whole

__all__ = ["ActionChunk", "chunked"]


def chunked(single: gym.Space[Any], length: int) -> gym.spaces.Box:
    """Space (length, A) of ``length`` actions of a box (A,).

    Raises:
        PwmGymError: no box, or no length.
    """
    check_whole("length", length, 1)
    if not isinstance(single, gym.spaces.Box):
        raise PwmGymError(f"ActionChunk needs a Box of actions; got {type(single).__name__}")
    low, high = (np.stack([bound] * length) for bound in (single.low, single.high))
    return gym.spaces.Box(low, high, dtype=single.dtype.type)


class ActionChunk(gym.Wrapper[Any, np.ndarray, Any, np.ndarray], RecordConstructorArgs):
    """Takes ``length`` actions (length, A) a step, and makes them one after the other until the episode ends.

    The reward is their sum; ``info["chunk"]`` has ``rewards`` of each that was made.

    Args:
        env: environment with a box of actions (A,).
        length: number of actions a step.

    Example:
        >>> env = ActionChunk(gym.make("pwm/PickCube-v0"), 4)
        >>> env.action_space.shape
        (4, 7)
    """

    def __init__(self, env: gym.Env[Any, np.ndarray], length: int) -> None:
        RecordConstructorArgs.__init__(self, length=length)
        gym.Wrapper.__init__(self, env)
        self.action_space = chunked(env.action_space, length)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make the actions (length, A) one after the other."""
        shape, found = self.action_space.shape, np.shape(action)
        if found != shape:
            raise PwmGymError(f"a chunk of actions has shape {found}; expected {shape}")
        rewards: list[float] = []
        for single in action:
            observation, reward, terminated, truncated, info = self.env.step(single)
            rewards.append(float(reward))
            if terminated or truncated:
                break
        return observation, sum(rewards), terminated, truncated, {**info, "chunk": {"rewards": rewards}}
