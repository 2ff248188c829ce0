"""What simulators' shaped rewards are made of."""

from __future__ import annotations

import numpy as np

__all__ = ["near"]


def near(a: np.ndarray, b: np.ndarray) -> float:
    """1 where places (3,) coincide, and 1 - tanh(5 d) where they are d metres apart."""
    return float(1.0 - np.tanh(5.0 * np.linalg.norm(a - b)))
