"""Our models inside other libraries' planners; those libraries are the extra ``planners``."""

from pwm_gym.planning.adapters.flat import FlatModel

__all__ = ["FlatModel"]
