"""Positions of joints, read off entity poses, and their limits."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pwm_gym.errors import SceneError
from pwm_gym.scene.layout import Layout
from pwm_gym.scene.se3 import inverse, matrix_from_pose7, vector_from_rotation

__all__ = ["joint_positions", "within_limits"]

_BEYOND = 0.02  # of a joint's range, by which it may exceed its limits: simulators do, too, and contacts push there


def joint_positions(layout: Layout, poses: Tensor, entity: int) -> Tensor:
    """Position (...) of an entity's joint at poses (..., E, 4, 4): radians, or metres for a prismatic joint."""
    joint = layout.entities[entity].joint
    pose = poses[..., entity, :, :]
    if joint.parent is not None:
        pose = inverse(poses[..., layout.index(joint.parent), :, :]) @ pose
    local = inverse(_origin(layout, entity, poses)) @ pose
    axis = torch.tensor(joint.axis, dtype=poses.dtype)
    if joint.kind == "prismatic":
        return local[..., :3, 3] @ axis
    return vector_from_rotation(local[..., :3, :3]) @ axis


def within_limits(
    what: str, position: float, low: float, high: float, share: float = _BEYOND, least: float = 0.0
) -> float:
    """A joint's position, radians or metres, brought within its limits.

    Args:
        what: it is, for the error.
        position: of the joint.
        low: limit.
        high: limit.
        share: of its range, by which it may be beyond them.
        least: by how much it may be, however short its range is.

    Raises:
        SceneError: it is far beyond them.
    """
    slack = max(least, share * (high - low)) if math.isfinite(high - low) else 0.0
    if not low - slack <= position <= high + slack:
        raise SceneError(f"{what} is at {position:.4f}; expected {low:.4f} to {high:.4f}")
    return min(max(position, low), high)


def _origin(layout: Layout, entity: int, like: Tensor) -> Tensor:
    """Pose (4, 4) of an entity in its parent's frame at position 0."""
    return matrix_from_pose7(torch.tensor(layout.entities[entity].joint.origin, dtype=torch.float64)).to(like)
