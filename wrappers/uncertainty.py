"""Rewards that fear what the model does not know."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from pwm_gym.errors import PwmGymError, is_number

__all__ = ["UNSURE", "UncertaintyPenalty", "check_penalty", "total_error"]

UNSURE = "unsure"
"""``info["reason"]`` of an episode that ended where the model is too unsure."""


def total_error(info: dict[str, Any]) -> Any:
    """Sum of all entities' expected errors in metres, a number or (num_envs,).

    Raises:
        PwmGymError: the world model does not tell them.
    """
    errors = info.get("expected_error")
    if errors is None:
        raise PwmGymError("info has no 'expected_error'; UncertaintyPenalty needs a world model that tells it")
    return sum(value for name, value in errors.items() if not name.startswith("_"))


def check_penalty(weight: float, limit: float | None = None) -> None:
    """Refuse settings that cannot be.

    Raises:
        PwmGymError: naming the setting and what was expected.
    """
    if not is_number(weight) or not 0.0 <= weight < float("inf"):
        raise PwmGymError(f"weight={weight!r}; expected a finite value of at least 0")
    if limit is not None and (not is_number(limit) or limit <= 0.0):
        raise PwmGymError(f"limit={limit!r}; expected more than 0 metres, or None")


class UncertaintyPenalty(gym.Wrapper[Any, np.ndarray, Any, np.ndarray], RecordConstructorArgs):
    """Takes ``weight`` times the model's expected error off the reward, and may end where it is too large.

    A policy that learns inside a model finds where it is wrong; there the model expects larger errors of itself.

    Args:
        env: model environment whose world model tells its expected error (``compact`` does).
        weight: reward for a metre of expected error, all entities together.
        limit: expected error in metres at which an episode is truncated, with ``info["reason"] == "unsure"``; None
            never truncates.

    Example:
        >>> env = UncertaintyPenalty(gym.make("pwm/PickCube-v0"), weight=2.0, limit=0.1)
    """

    def __init__(self, env: gym.Env[Any, np.ndarray], weight: float, limit: float | None = None) -> None:
        RecordConstructorArgs.__init__(self, weight=weight, limit=limit)
        gym.Wrapper.__init__(self, env)
        check_penalty(weight, limit)
        self.weight, self.limit = weight, limit

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step, and judge how far the prediction can be trusted."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        error = float(total_error(info))
        if self.limit is not None and error > self.limit and not terminated:
            truncated, info = True, {**info, "reason": info["reason"] or UNSURE}
        return observation, float(reward) - self.weight * error, terminated, truncated, info
