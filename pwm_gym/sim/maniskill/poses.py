"""Poses of SAPIEN as arrays: xyz in metres, unit quaternion wxyz."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["pose7"]


def pose7(pose: Any) -> np.ndarray:
    """A SAPIEN pose as (7,), float64."""
    return np.concatenate([pose.p, pose.q]).astype(np.float64)
