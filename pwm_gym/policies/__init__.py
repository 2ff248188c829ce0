"""Policies: actions straight from a scene, without planning. The plain anchor is behaviour cloning."""

from pwm_gym.policies.agent import ActsOnPoses, PolicyAgent
from pwm_gym.policies.cloning import CloningConfig, clone, cloning_took, load_policy
from pwm_gym.policies.network import Policy, PolicyConfig

__all__ = [
    "ActsOnPoses",
    "CloningConfig",
    "Policy",
    "PolicyAgent",
    "PolicyConfig",
    "clone",
    "cloning_took",
    "load_policy",
]
