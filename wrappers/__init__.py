"""Wrappers: twins side by side, observations for policies, recording, stable-baselines3."""

from typing import TYPE_CHECKING, Any

from pwm_gym.wrappers.observations import EntityPoses, FlattenPoints
from pwm_gym.wrappers.record import RecordRollout
from pwm_gym.wrappers.twin import Twin, divergence

if TYPE_CHECKING:
    from pwm_gym.wrappers.sb3 import SB3VecEnv

__all__ = ["EntityPoses", "FlattenPoints", "RecordRollout", "SB3VecEnv", "Twin", "divergence"]


def __getattr__(name: str) -> Any:
    """Stable-baselines3 takes seconds to import: only when it is asked for."""
    if name == "SB3VecEnv":
        from pwm_gym.wrappers.sb3 import SB3VecEnv

        return SB3VecEnv
    raise AttributeError(f"module 'pwm_gym.wrappers' has no attribute {name!r}")
