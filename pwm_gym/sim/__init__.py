"""Simulators as sources of poses. Importing this package loads no simulator."""

from pwm_gym.sim.protocol import SimOutcome, Simulator

__all__ = ["SimOutcome", "Simulator"]
