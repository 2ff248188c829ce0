"""The paper's network."""

from pwm_gym.dynamics.paper.model import PaperConfig, PaperModel, SmallPaperConfig

__all__ = ["PaperConfig", "PaperModel", "SmallPaperConfig"]
