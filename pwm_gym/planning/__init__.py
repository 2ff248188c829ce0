"""Planners and their execution. They receive a model or an environment; they know no simulator."""

from pwm_gym.planning.agent import Agent
from pwm_gym.planning.cem import CEM, CEMConfig
from pwm_gym.planning.constraints import keep_clear, workspace
from pwm_gym.planning.execute import execute
from pwm_gym.planning.gradient import GradientConfig, GradientPlanner
from pwm_gym.planning.mppi import MPPI, MPPIConfig
from pwm_gym.planning.noise import ActionNoise, NoiseConfig
from pwm_gym.planning.objective import RolloutObjective
from pwm_gym.planning.posture import PosedModel, Posture
from pwm_gym.planning.registry import PLANNERS, build_planner, get_planner_config
from pwm_gym.planning.run import Run
from pwm_gym.planning.sampling import Objective, Planner, SamplingConfig

__all__ = [
    "CEM",
    "MPPI",
    "PLANNERS",
    "ActionNoise",
    "Agent",
    "CEMConfig",
    "GradientConfig",
    "GradientPlanner",
    "MPPIConfig",
    "NoiseConfig",
    "Objective",
    "Planner",
    "PosedModel",
    "Posture",
    "RolloutObjective",
    "Run",
    "SamplingConfig",
    "build_planner",
    "execute",
    "get_planner_config",
    "keep_clear",
    "workspace",
]
