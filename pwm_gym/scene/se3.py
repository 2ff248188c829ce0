"""Rigid motions, batched over any leading dimensions.

A pose is a (4, 4) homogeneous matrix that takes canonical coordinates to the world frame, or its (7,) form
``x y z qw qx qy qz`` (metres, unit quaternion). A twist is (6,): translation (metres), rotation vector (radians).
"""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = [
    "inverse",
    "make_pose",
    "matrix_from_pose7",
    "motion_vector",
    "pose7_from_matrix",
    "rotation_angle",
    "rotation_from_vector",
    "transform",
    "vector_from_rotation",
]

_SMALL_ANGLE = 1e-6  # radians; below it sin(x)/x and (1-cos(x))/x^2 take their limits


def make_pose(rotation: Tensor, translation: Tensor) -> Tensor:
    """Pose (..., 4, 4) of a rotation (..., 3, 3) and a translation (..., 3)."""
    top = torch.cat([rotation, translation.unsqueeze(-1)], -1)
    bottom = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, bottom], -2)


def inverse(pose: Tensor) -> Tensor:
    """Inverse (..., 4, 4) of a rigid pose (..., 4, 4)."""
    rotation = pose[..., :3, :3].transpose(-1, -2)
    return make_pose(rotation, -(rotation @ pose[..., :3, 3:]).squeeze(-1))


def transform(pose: Tensor, points: Tensor) -> Tensor:
    """Points (..., n, 3) moved by poses (..., 4, 4)."""
    return points @ pose[..., :3, :3].transpose(-1, -2) + pose[..., None, :3, 3]


def rotation_from_vector(vector: Tensor) -> Tensor:
    """Rotation (..., 3, 3) of a rotation vector (..., 3) in radians (Rodrigues' formula)."""
    angle2 = (vector * vector).sum(-1, keepdim=True).unsqueeze(-1)  # (..., 1, 1)
    angle = angle2.clamp_min(_SMALL_ANGLE**2).sqrt()
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    eye = torch.eye(3, dtype=vector.dtype, device=vector.device)
    half = 0.5 * angle
    return eye + torch.sin(angle) / angle * cross + 0.5 * (torch.sin(half) / half) ** 2 * (cross @ cross)


def vector_from_rotation(rotation: Tensor) -> Tensor:
    """Rotation vector (..., 3) in radians of a rotation (..., 3, 3)."""
    import roma  # it takes 1.6 s to import, and environments do without

    return roma.rotmat_to_rotvec(rotation)


def motion_vector(rotation: Tensor) -> Tensor:
    """Rotation vector (..., 3) of a turn well below half a revolution (..., 3, 3), as between two control steps.

    Cheaper than :func:`vector_from_rotation` and differentiable at rest; not for angles near pi.
    """
    skew = 0.5 * (rotation - rotation.transpose(-1, -2))
    sine_axis = torch.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], -1)
    sine = sine_axis.square().sum(-1, keepdim=True).clamp_min(_SMALL_ANGLE**2).sqrt()
    cosine = 0.5 * (rotation.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) - 1.0)
    return sine_axis * (torch.atan2(sine, cosine) / sine)


def rotation_angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle (...) in radians between rotations (..., 3, 3)."""
    import roma

    return roma.rotmat_geodesic_distance(a, b)


def matrix_from_pose7(pose7: Tensor) -> Tensor:
    """Pose (..., 4, 4) of its (..., 7) form."""
    quaternion = pose7[..., 3:] / pose7[..., 3:].norm(dim=-1, keepdim=True)
    w, x, y, z = quaternion.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return make_pose(torch.stack(rows, -1).unflatten(-1, (3, 3)), pose7[..., :3])


def pose7_from_matrix(pose: Tensor) -> Tensor:
    """(..., 7) form of a pose (..., 4, 4), with qw >= 0."""
    import roma

    quaternion = roma.rotmat_to_unitquat(pose[..., :3, :3])
    quaternion = torch.where(quaternion[..., 3:] < 0, -quaternion, quaternion)
    return torch.cat([pose[..., :3, 3], quaternion[..., 3:], quaternion[..., :3]], -1)
