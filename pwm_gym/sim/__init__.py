"""Simulators as sources of poses. Importing this package loads no simulator."""

from pwm_gym.sim.protocol import PlacesBodies, SimOutcome, Simulator

__all__ = ["PlacesBodies", "SimOutcome", "Simulator"]
