"""Wrappers that change what a living environment is rewarded by and what it sees."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from torch import Tensor

from pwm_gym.envs.model_env import ModelEnv
from pwm_gym.envs.observation_models import CameraConfig
from pwm_gym.envs.sim_env import SimEnv
from pwm_gym.errors import PwmGymError

__all__ = ["Completed", "CostFunction"]


class CostFunction(gym.Wrapper[Any, np.ndarray, Any, np.ndarray], RecordConstructorArgs):
    """Rewards by another cost from the next step on; success stays what it was.

    It changes the environment that it wraps: rewards, ``info["cost_terms"]`` and ``info["stage"]`` are of the new cost.

    Args:
        env: a model environment or a simulator twin.
        cost: a registered cost, or a callable ``(points, info) -> (B,)``.

    Example:
        >>> env = CostFunction(gym.make("pwm/PickCube-v0"), "pick_cube_plan")
        >>> env.unwrapped.rules.cost.name
        'pick_cube_plan'
    """

    def __init__(self, env: gym.Env[Any, np.ndarray], cost: str | Callable[..., Tensor]) -> None:
        RecordConstructorArgs.__init__(self, cost=cost)
        gym.Wrapper.__init__(self, env)
        base = env.unwrapped
        if not isinstance(base, ModelEnv | SimEnv):
            raise PwmGymError(f"CostFunction wraps a ModelEnv or a SimEnv; got {type(base).__name__}")
        base.set_cost(cost)


class Completed(gym.Wrapper[Any, np.ndarray, Any, np.ndarray], RecordConstructorArgs):
    """Shows what perception makes of one camera's depth, from the next reset on: objects completed and tracked.

    Args:
        env: a simulator twin.
        camera: viewpoint, sensor and completer, as ``gym.make(..., camera=...)`` takes them.

    Example:
        >>> env = Completed(gym.make("pwm/PickCubeSim-v0", points=200), camera="left")
        >>> observation, info = env.reset(seed=0)
        >>> observation["points"].shape  # of the surface that completion tells of, as many as complete clouds have
        (200, 3)
    """

    def __init__(
        self, env: gym.Env[Any, np.ndarray], camera: CameraConfig | Mapping[str, Any] | str | None = None
    ) -> None:
        RecordConstructorArgs.__init__(self, camera=camera)
        gym.Wrapper.__init__(self, env)
        base = env.unwrapped
        if not isinstance(base, SimEnv):
            raise PwmGymError(f"Completed wraps a SimEnv; got {type(base).__name__}")
        base.set_observation("completed", camera)
