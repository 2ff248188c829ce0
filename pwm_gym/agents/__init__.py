"""Agents trained by reinforcement learning (stable-baselines3) inside a world model, or in its simulator twin."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pwm_gym.agents.config import AgentConfig

if TYPE_CHECKING:
    from pwm_gym.agents.policy import LearnedPolicy, load_agent
    from pwm_gym.agents.training import train

__all__ = ["AgentConfig", "LearnedPolicy", "load_agent", "train"]


def __getattr__(name: str) -> Any:
    """Stable-baselines3 is imported when it is first needed: the command line reads the settings alone."""
    if name in ("LearnedPolicy", "load_agent"):
        from pwm_gym.agents import policy

        return getattr(policy, name)
    if name == "train":
        from pwm_gym.agents.training import train

        return train
    raise AttributeError(f"module 'pwm_gym.agents' has no attribute {name!r}")
