"""Our models inside other planners: `pytorch_mppi` and `torchrl` (extra "planners"), stable-worldmodel."""

from pwm_gym.planning.adapters.flat import FlatModel
from pwm_gym.planning.adapters.stable_worldmodel import CostModel

__all__ = ["CostModel", "FlatModel"]
