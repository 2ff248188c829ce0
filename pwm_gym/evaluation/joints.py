"""Positions of joints read off entity poses."""

from __future__ import annotations

import torch
from torch import Tensor

from pwm_gym.scene import Layout
from pwm_gym.scene.se3 import inverse, matrix_from_pose7, rotation_from_vector, vector_from_rotation

__all__ = ["along_joint", "joint_positions"]


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


def along_joint(layout: Layout, poses: Tensor, entity: int, distance: float, cloud: Tensor) -> Tensor:
    """Pose (..., 4, 4) of an entity moved along its joint, towards the farther limit.

    Args:
        layout: the scene's entities.
        poses: (..., E, 4, 4).
        entity: place of the one that moves.
        distance: metres; of a revolute joint, of the point that is farthest from the axis.
        cloud: the entity's canonical points (n, 3).
    """
    joint = layout.entities[entity].joint
    position = joint_positions(layout, poses, entity).flatten()[0]
    sign = 1.0 if joint.upper - position >= position - joint.lower else -1.0
    axis = torch.tensor(joint.axis, dtype=poses.dtype)
    moved = torch.eye(4, dtype=poses.dtype)
    if joint.kind == "prismatic":
        moved[:3, 3] = sign * distance * axis
    else:
        lever = torch.linalg.cross(axis.expand_as(cloud), cloud.to(axis)).norm(dim=-1).max().clamp_min(1e-3)
        moved[:3, :3] = rotation_from_vector(sign * distance / lever * axis)
    return poses[..., entity, :, :] @ moved


def _origin(layout: Layout, entity: int, like: Tensor) -> Tensor:
    """Pose (4, 4) of an entity in its parent's frame at position 0."""
    return matrix_from_pose7(torch.tensor(layout.entities[entity].joint.origin, dtype=torch.float64)).to(like)
