"""Poses of SAPIEN as arrays: xyz in metres, unit quaternion wxyz."""

from __future__ import annotations

from typing import Any

import numpy as np

from pwm_gym.scene.poses import compose, relative, rotation

__all__ = ["compose", "pose7", "relative", "rotation"]


def pose7(pose: Any) -> np.ndarray:
    """A SAPIEN pose as (7,), float64."""
    return np.concatenate([pose.p, pose.q]).astype(np.float64)
