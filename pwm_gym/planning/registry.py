"""Planners by name."""

from __future__ import annotations

from pwm_gym.errors import PwmGymError
from pwm_gym.planning.cem import CEM, CEMConfig
from pwm_gym.planning.gradient import GradientConfig, GradientPlanner
from pwm_gym.planning.mppi import MPPI, MPPIConfig
from pwm_gym.planning.sampling import Planner, SamplingConfig

__all__ = ["build_planner"]

_PLANNERS: dict[type[SamplingConfig], type] = {MPPIConfig: MPPI, CEMConfig: CEM, GradientConfig: GradientPlanner}


def build_planner(config: SamplingConfig, action_size: int, device: str = "cpu") -> Planner:
    """The planner that a configuration is of.

    Raises:
        PwmGymError: it is of none, or holds a setting that cannot be.
    """
    if type(config) not in _PLANNERS:
        known = ", ".join(kind.__name__ for kind in _PLANNERS)
        raise PwmGymError(f"{type(config).__name__} is no planner's configuration; expected one of {known}")
    planner: Planner = _PLANNERS[type(config)](config, action_size, device)
    return planner
