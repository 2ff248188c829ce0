"""Random choices of shapes and views."""

from __future__ import annotations

import numpy as np

__all__ = ["chance", "log_uniform", "turn_angles"]


def chance(rng: np.random.Generator, probability: float) -> bool:
    """True with this ``probability``."""
    return bool(rng.random() < probability)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number in [low, high], its logarithm uniform: halving and doubling are equally likely."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def turn_angles(rng: np.random.Generator) -> list[float]:
    """Turns about x, y and z in degrees; often whole quarters, so that faces meet at right angles."""
    if chance(rng, 0.4):
        return [90.0 * float(k) for k in rng.integers(0, 4, 3)]
    return [float(a) for a in rng.uniform(0, 360, 3)]
