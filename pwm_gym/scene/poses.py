"""Poses as arrays: xyz in metres, unit quaternion wxyz."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

__all__ = ["compose", "mirrored", "relative", "rotation", "turn_between"]


def rotation(pose: np.ndarray) -> Rotation:
    """Rotation of poses (..., 7)."""
    return Rotation.from_quat(pose[..., 3:], scalar_first=True)


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Pose (7,) of ``b`` (7,), given in the frame of ``a`` (7,), in the frame of ``a``'s parent."""
    turn = rotation(a)
    return np.r_[a[:3] + turn.apply(b[:3]), (turn * rotation(b)).as_quat(scalar_first=True)]


def relative(base: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Poses (E, 7), given in the parent's frame of ``base`` (7,), in the frame of ``base``."""
    inverse = rotation(base).inv()
    turned = (inverse * rotation(poses)).as_quat(canonical=True, scalar_first=True)
    return np.concatenate([inverse.apply(poses[:, :3] - base[:3]), turned], -1)


def mirrored(poses: np.ndarray) -> np.ndarray:
    """Poses (..., 7) seen in a mirror along the x and z axes, of bodies that are their own mirror image."""
    return poses * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])


def turn_between(base: np.ndarray, part: np.ndarray) -> float:
    """Angle from 0 to pi, radians, by which a pose (7,) is turned against another (7,)."""
    return float((rotation(base).inv() * rotation(part)).magnitude())
