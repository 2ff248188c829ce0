"""Planners and their execution. They receive a model or an environment; they know no simulator."""

from pwm_gym.planning.execute import Agent, Run, closed_loop
from pwm_gym.planning.mppi import MPPI, MPPIConfig, Objective
from pwm_gym.planning.objective import RolloutObjective

__all__ = ["MPPI", "Agent", "MPPIConfig", "Objective", "RolloutObjective", "Run", "closed_loop"]
