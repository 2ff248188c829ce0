"""World models of completed point clouds, their training, checkpoints and baselines."""

from pwm_gym.dynamics.averaging import average
from pwm_gym.dynamics.checkpoint import Checkpoint, SceneBank, load_checkpoint, resolve, save_checkpoint
from pwm_gym.dynamics.compact.model import CompactConfig, CompactModel
from pwm_gym.dynamics.hub import from_pretrained, push_to_hub, save_pretrained
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
    "average",
    "build_model",
    "from_pretrained",
    "load_checkpoint",
    "push_to_hub",
    "resolve",
    "rollout",
    "save_checkpoint",
    "save_pretrained",
]
