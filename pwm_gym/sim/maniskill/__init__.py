"""ManiSkill tasks as simulators. Importing this package loads no simulator."""

from pwm_gym.sim.maniskill.adapter import AssetChoice, ManiSkillSimulator

__all__ = ["AssetChoice", "ManiSkillSimulator"]
