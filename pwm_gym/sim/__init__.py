"""Simulators as sources of poses. Importing this package loads no simulator."""

from pwm_gym.sim.protocol import Past, PlacesBodies, SimOutcome, Simulator, StartsUnderway

__all__ = ["Past", "PlacesBodies", "SimOutcome", "Simulator", "StartsUnderway"]
