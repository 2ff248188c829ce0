"""The same wrappers for the native batch, ``gym.make_vec``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from torch import Tensor

from pwm_gym.envs.common import check_actions
from pwm_gym.envs.model_vector_env import ModelVectorEnv
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Layout
from pwm_gym.wrappers.chunks import chunked
from pwm_gym.wrappers.observations import at_points, subsampled
from pwm_gym.wrappers.uncertainty import UNSURE, check_penalty, total_error

__all__ = ["ActionChunk", "CostFunction", "Subsample", "UncertaintyPenalty"]


def _native(env: gym.vector.VectorEnv[Any, Any, Any], name: str) -> ModelVectorEnv:
    """The batch within ``env``."""
    base = env.unwrapped
    if not isinstance(base, ModelVectorEnv):
        raise PwmGymError(f"{name} wraps a ModelVectorEnv; got {type(base).__name__}")
    return base


class ActionChunk(gym.vector.VectorWrapper):
    """As :class:`pwm_gym.wrappers.ActionChunk`: (num_envs, length, A) a step.

    An environment whose episode ends within the chunk stands still for the rest of it, and one that restarts makes none
    of the chunk. ``info["chunk"]`` has ``rewards`` (num_envs, length), 0 for what was not made, and ``steps``
    (num_envs,), how many were. Put wrappers that count steps around it: within, they count those who wait, too.

    Args:
        env: native batch.
        length: number of actions a step.

    Example:
        >>> envs = ActionChunk(gym.make_vec("pwm/PickCube-v0", num_envs=2), 4)
        >>> envs.action_space.shape
        (2, 4, 7)
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], length: int) -> None:
        super().__init__(env)
        self._batch = _native(env, "ActionChunk")
        self.length = length
        self.single_action_space = chunked(env.single_action_space, length)
        self.action_space = batch_space(self.single_action_space, env.num_envs)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Make each environment's actions one after the other until its episode ends."""
        chunks = check_actions(actions, self.action_space.shape or ())
        held = self._batch.held
        restarting, going = self._batch.done & ~held, ~held
        ends, steps = np.zeros((2, self.num_envs), bool), np.zeros(self.num_envs, np.int64)
        rewards: list[Any] = []
        told: Any = None
        try:
            for k in range(self.length):
                self._batch.hold(~going)
                observation, reward, *ended, info = self.env.step(chunks[:, k])
                told = (observation, info) if going.all() or told is None else _chosen(going, (observation, info), told)
                rewards.append(_chosen(going, reward, 0.0 * reward))
                ends |= ended
                steps += going & ~restarting
                going = going & ~ends.any(0) & ~restarting
                if not going.any():
                    break
        finally:
            self._batch.hold(held)
        rewards += [0.0 * rewards[0]] * (self.length - len(rewards))
        every = np.ones(self.num_envs, bool)
        made = {"rewards": _stacked(rewards), "_rewards": every, "steps": steps, "_steps": every.copy()}
        observation, info = told
        return observation, sum(rewards), *ends, {**info, "chunk": made, "_chunk": every.copy()}


def _stacked(rewards: list[Any]) -> np.ndarray:
    """Rewards (num_envs, length)."""
    return np.stack([r.cpu().numpy() if isinstance(r, Tensor) else r for r in rewards], axis=1)


def _chosen(mask: np.ndarray, new: Any, old: Any) -> Any:
    """Rows of ``new`` where the mask is set, of ``old`` elsewhere; what only one of them has is kept."""
    if isinstance(new, dict):
        return {**old, **{key: _chosen(mask, new[key], old.get(key, new[key])) for key in new}}
    if isinstance(new, tuple):
        return tuple(_chosen(mask, *pair) for pair in zip(new, old, strict=True))
    rows = torch.as_tensor(mask, device=new.device) if isinstance(new, Tensor) else mask
    chosen = old.clone() if isinstance(old, Tensor) else old.copy()
    chosen[rows] = new[rows]
    return chosen


class CostFunction(gym.vector.VectorWrapper):
    """As :class:`pwm_gym.wrappers.CostFunction`, of all environments.

    Args:
        env: native batch.
        cost: a registered cost, or a callable ``(points, info) -> (B,)``.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], cost: str | Callable[..., Tensor]) -> None:
        super().__init__(env)
        _native(env, "CostFunction").set_cost(cost)


class Subsample(gym.vector.VectorWrapper):
    """As :class:`pwm_gym.wrappers.Subsample`: observations, and the last ones of ended episodes, have fewer points.

    Args:
        env: native batch.
        points: number of points of a scene in all.

    Example:
        >>> envs = Subsample(gym.make_vec("pwm/PickCube-v0", num_envs=2), 100)
        >>> envs.single_observation_space["points"].shape
        (100, 3)
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], points: int) -> None:
        super().__init__(env)
        layout = Layout(_native(env, "Subsample").entities)
        self.single_observation_space, self._kept = subsampled(env.single_observation_space, layout, points)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.entities = layout.resize(points).entities

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """First observations (num_envs, ...)."""
        observation, info = self.env.reset(seed=seed, options=options)
        return at_points(observation, self._kept), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step of every environment."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        if "final_obs" in info:
            info = {**info, "final_obs": at_points(info["final_obs"], self._kept)}
        return at_points(observation, self._kept), reward, terminated, truncated, info


class UncertaintyPenalty(gym.vector.VectorWrapper):
    """As :class:`pwm_gym.wrappers.UncertaintyPenalty`, of all environments; a restart costs nothing.

    Args:
        env: native batch whose world model tells its expected error.
        weight: reward for a metre of expected error, all entities together.
        limit: expected error in metres at which an episode is truncated, with "unsure" in ``info["reason"]``; None
            never truncates. Autoreset "SameStep", which restarts within the step, has no limit.

    Example:
        >>> envs = UncertaintyPenalty(gym.make_vec("pwm/PickCube-v0", num_envs=2), weight=2.0, limit=0.1)
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], weight: float, limit: float | None = None) -> None:
        super().__init__(env)
        check_penalty(weight, limit)
        self.weight, self.limit = weight, limit
        self._batch = _native(env, "UncertaintyPenalty")
        if limit is not None and self._batch.autoreset_mode is AutoresetMode.SAME_STEP:
            raise PwmGymError(f"limit={limit} with autoreset_mode 'SameStep'; expected 'NextStep' or 'Disabled'")

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step of every environment; the error of an episode's last step counts, not that of the next one's."""
        resting = self._batch.done | self._batch.held
        observation, reward, terminated, truncated, info = self.env.step(actions)
        error = np.where(resting, 0.0, total_error(info))
        if "final_info" in info:
            error = np.where(info["_final_info"], total_error(info["final_info"]), error)
        if self.limit is not None:
            unsure = (error > self.limit) & ~terminated
            self._batch.end(unsure)
            truncated = truncated | unsure
            reasons = info["reason"].copy()
            reasons[unsure & (reasons == "")] = UNSURE
            info = {**info, "reason": reasons}
        penalty = self.weight * error.astype(np.float32)
        return observation, reward - self._like(reward, penalty), terminated, truncated, info

    @staticmethod
    def _like(reward: Any, penalty: np.ndarray) -> Any:
        """The penalty as an array or a tensor, as the reward is."""
        return reward.new_tensor(penalty) if isinstance(reward, Tensor) else penalty
