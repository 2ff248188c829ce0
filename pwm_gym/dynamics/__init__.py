"""World models of completed point clouds, their training, checkpoints and baselines."""

from pwm_gym.dynamics.checkpoint import Checkpoint, SceneBank, load_checkpoint, resolve, save_checkpoint
from pwm_gym.dynamics.compact.model import CompactConfig, CompactModel
from pwm_gym.dynamics.model import WorldModel, rollout
from pwm_gym.dynamics.paper.model import PaperConfig, PaperModel
from pwm_gym.dynamics.registry import MODELS, build_model

__all__ = [
    "MODELS",
    "Checkpoint",
    "CompactConfig",
    "CompactModel",
    "PaperConfig",
    "PaperModel",
    "SceneBank",
    "WorldModel",
    "build_model",
    "load_checkpoint",
    "resolve",
    "rollout",
    "save_checkpoint",
]
