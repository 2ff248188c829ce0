"""What every training shares: the loop, the optimisers and the files of weights. Knows nothing of what is trained."""

from pwm_gym.learning.clock import Clock
from pwm_gym.learning.loggers import Logger, logging_to, tell_loggers
from pwm_gym.learning.loop import LoopConfig, has_state, is_main_process, run_training
from pwm_gym.learning.optimizers import Optimizer, build_optimizer
from pwm_gym.learning.weights import digest, load_weights, read_description, rebuild, save_weights

__all__ = [
    "Clock",
    "Logger",
    "LoopConfig",
    "Optimizer",
    "build_optimizer",
    "digest",
    "has_state",
    "is_main_process",
    "load_weights",
    "logging_to",
    "read_description",
    "rebuild",
    "run_training",
    "save_weights",
    "tell_loggers",
]
