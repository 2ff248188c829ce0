"""Wrappers: twins side by side, observations, costs, chunks, caution, recording, stable-baselines3.

Of the native batch: :mod:`pwm_gym.wrappers.vector`.
"""

from typing import TYPE_CHECKING, Any

from pwm_gym.wrappers.chunks import ActionChunk
from pwm_gym.wrappers.observations import EntityPoses, FlattenPoints, Subsample
from pwm_gym.wrappers.record import RecordRollout
from pwm_gym.wrappers.settings import Completed, CostFunction
from pwm_gym.wrappers.twin import Twin, divergence
from pwm_gym.wrappers.uncertainty import UncertaintyPenalty

if TYPE_CHECKING:
    from pwm_gym.wrappers.sb3 import SB3VecEnv

__all__ = [
    "ActionChunk",
    "Completed",
    "CostFunction",
    "EntityPoses",
    "FlattenPoints",
    "RecordRollout",
    "SB3VecEnv",
    "Subsample",
    "Twin",
    "UncertaintyPenalty",
    "divergence",
]


def __getattr__(name: str) -> Any:
    """Stable-baselines3 takes seconds to import: only when it is asked for."""
    if name == "SB3VecEnv":
        from pwm_gym.wrappers.sb3 import SB3VecEnv

        return SB3VecEnv
    raise AttributeError(f"module 'pwm_gym.wrappers' has no attribute {name!r}")
