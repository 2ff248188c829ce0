"""Planners by name, and by their configuration."""

from __future__ import annotations

from collections.abc import Sequence

from pwm_gym.errors import PwmGymError, look_up
from pwm_gym.planning.cem import CEM, CEMConfig
from pwm_gym.planning.gradient import GradientConfig, GradientPlanner
from pwm_gym.planning.mppi import MPPI, MPPIConfig
from pwm_gym.planning.sampling import Planner, SamplingConfig
from pwm_gym.robots import Control

__all__ = ["PLANNERS", "build_planner", "get_planner_config"]

PLANNERS: dict[str, SamplingConfig] = {
    "mppi": MPPIConfig(),
    "mppi-fine": MPPIConfig.fine(),
    "mppi-hands": MPPIConfig.hands(),
    "mppi-pair": MPPIConfig.pair(),
    "mppi-paper": MPPIConfig.paper(),
    "cem": CEMConfig(),
    "icem": CEMConfig.icem(),
    "gradient": GradientConfig(),
}
"""Name -> default settings."""

_BUILDERS: dict[type[SamplingConfig], type] = {MPPIConfig: MPPI, CEMConfig: CEM, GradientConfig: GradientPlanner}


def get_planner_config(name: str) -> SamplingConfig:
    """Settings of the planner called ``name``.

    Raises:
        UnknownNameError: listing the known planners and the nearest one.
    """
    return look_up("planner", name, PLANNERS)


def build_planner(config: SamplingConfig, control: Control, device: str = "cpu", fixed: Sequence[int] = ()) -> Planner:
    """The planner that a configuration is of, for a robot's actions, ``fixed`` components of which it leaves alone.

    Raises:
        PwmGymError: it is of none, or holds a setting that does not fit the control.
    """
    if type(config) not in _BUILDERS:
        known = ", ".join(kind.__name__ for kind in _BUILDERS)
        raise PwmGymError(f"{type(config).__name__} is no planner's configuration; expected one of {known}")
    planner: Planner = _BUILDERS[type(config)](config, control, device, fixed)
    return planner
