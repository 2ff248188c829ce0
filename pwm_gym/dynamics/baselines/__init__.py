"""What a world model is compared with: other learned ones, and ones without learning."""

from pwm_gym.dynamics.baselines.graph import GraphConfig, GraphModel
from pwm_gym.dynamics.baselines.linear import BaselineConfig, Commanded, LinearBaseline, Still
from pwm_gym.dynamics.baselines.particleformer import ParticleFormer, ParticleFormerConfig

__all__ = [
    "BaselineConfig",
    "Commanded",
    "GraphConfig",
    "GraphModel",
    "LinearBaseline",
    "ParticleFormer",
    "ParticleFormerConfig",
    "Still",
]
