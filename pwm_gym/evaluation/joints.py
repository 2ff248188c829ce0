"""Parts moved along their joints."""

from __future__ import annotations

import torch
from torch import Tensor

from pwm_gym.scene import Layout, joint_positions
from pwm_gym.scene.se3 import rotation_from_vector

__all__ = ["along_joint"]


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
