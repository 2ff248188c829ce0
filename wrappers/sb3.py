"""Stable-baselines3 on the native batch: its algorithms reject Gymnasium vector environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from pwm_gym.envs.model_vector_env import ModelVectorEnv
from pwm_gym.errors import PwmGymError

__all__ = ["SB3VecEnv"]


class SB3VecEnv(VecEnv):
    """A ``VecEnv`` whose step is one forward pass of the world model for all environments.

    Args:
        env: a native batch made with ``autoreset_mode="SameStep"``.
        observation: what it shows from now on: "poses" (as :class:`pwm_gym.wrappers.EntityPoses`) or "points" (the
            Dict of clouds and goal).

    Example:
        >>> env = gym.make_vec("pwm/PickCube-v0", num_envs=8, autoreset_mode="SameStep")  # doctest: +SKIP
        >>> SAC("MlpPolicy", SB3VecEnv(env)).learn(1000)  # doctest: +SKIP
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], observation: str = "poses") -> None:
        base = env.unwrapped
        if not isinstance(base, ModelVectorEnv):
            raise PwmGymError(f"SB3VecEnv takes a ModelVectorEnv; got {type(base).__name__}")
        if base.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise PwmGymError(f"autoreset_mode is {base.autoreset_mode}; expected AutoresetMode.SAME_STEP")
        base.observe_as(observation)
        self.env, self._base = env, base
        self._actions = np.zeros(env.action_space.shape or (), np.float32)
        self._seeds: int | None = None
        self.render_mode = base.render_mode
        super().__init__(base.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> Any:
        """First observations (num_envs, ...)."""
        observation, _ = self.env.reset(seed=self._seeds)
        self._seeds = None
        return observation

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed of the next reset."""
        self._seeds = seed
        return [None if seed is None else seed + i for i in range(self.num_envs)]

    def step_async(self, actions: np.ndarray) -> None:
        """Actions (num_envs, A), or chunks (num_envs, length, A), of the next :meth:`step_wait`."""
        self._actions = np.asarray(actions, np.float32)

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Observations, rewards, dones and infos; a done one's has its ``terminal_observation``."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        final = info.get("final_info", info)
        for i in map(int, np.flatnonzero(done)):
            infos[i] = {
                "is_success": bool(final["success"][i]),
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "terminal_observation": _row(info["final_obs"], i),
            }
        return observation, np.asarray(reward, np.float32), done, infos

    def close(self) -> None:
        """Close the batch."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute, once for each chosen environment."""
        value = getattr(self._base, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the batch."""
        setattr(self._base, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of the batch, once."""
        result = getattr(self._base, method_name)(*args, **kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No single environment is wrapped."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Pictures of all environments."""
        return list(self._base.render() or [None] * self.num_envs)


def _row(batch: Any, i: int) -> Any:
    """Row ``i`` of observations: an array, or a dict of arrays."""
    return {name: value[i] for name, value in batch.items()} if isinstance(batch, dict) else batch[i]
