"""The default world model."""

from pwm_gym.dynamics.compact.model import CompactConfig, CompactModel

__all__ = ["CompactConfig", "CompactModel"]
