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
    "turn",
    "turning",
    "vector_from_rotation",
]

_SMALL_ANGLE = 1e-6  # radians; below it x/sin(x) takes its limit
_EYE = torch.eye(3)
_BOTTOM = torch.tensor([[0.0, 0.0, 0.0, 1.0]])
# Of a vector (3,): its cross product's matrix, flat.
_CROSS = torch.linalg.cross(_EYE.unsqueeze(1), _EYE.unsqueeze(0)).transpose(1, 2).flatten(1)
# Of a flat rotation (9,): sine times axis, and the cosine but for a constant.
_SKEW_AND_TRACE = 0.5 * torch.cat([_CROSS, _EYE.flatten().unsqueeze(0)]).T


def make_pose(rotation: Tensor, translation: Tensor) -> Tensor:
    """Pose (..., 4, 4) of a rotation (..., 3, 3) and a translation (..., 3)."""
    top = torch.cat([rotation, translation.unsqueeze(-1)], -1)
    return torch.cat([top, _BOTTOM.to(top).expand(*top.shape[:-2], 1, 4)], -2)


def inverse(pose: Tensor) -> Tensor:
    """Inverse (..., 4, 4) of a rigid pose (..., 4, 4)."""
    rotation = pose[..., :3, :3].transpose(-1, -2)
    return make_pose(rotation, -(rotation @ pose[..., :3, 3:]).squeeze(-1))


def transform(pose: Tensor, points: Tensor) -> Tensor:
    """Points (..., n, 3) moved by poses (..., 4, 4).

    In memory the result runs along its points: such products, sums and minima of many points take a third of the time.
    """
    return (pose[..., :3, :3] @ points.transpose(-1, -2) + pose[..., :3, 3:]).transpose(-1, -2)


def rotation_from_vector(vector: Tensor) -> Tensor:
    """Rotation (..., 3, 3) of a rotation vector (..., 3) in radians (Rodrigues' formula)."""
    cross = (vector @ _CROSS.to(vector)).unflatten(-1, (3, 3))
    turns = torch.linalg.vector_norm(vector, dim=-1)[..., None, None] / torch.pi  # half revolutions
    linear = torch.addcmul(_EYE.to(vector), torch.sinc(turns), cross)
    return torch.addcmul(linear, torch.sinc(0.5 * turns).square(), cross @ cross, value=0.5)


def turning(axes: Tensor) -> Tensor:
    """Parts (3, ..., 3, 3) of turns about unit axes (..., 3): fixed, times the angle's cosine, and times its sine."""
    along = axes.unsqueeze(-1) * axes.unsqueeze(-2)
    return torch.stack([along, _EYE.to(axes) - along, (axes @ _CROSS.to(axes)).unflatten(-1, (3, 3))])


def turn(parts: Tensor, angle: Tensor) -> Tensor:
    """Rotations (..., m, m) by angles (...) in radians, of parts (3, ..., m, m) as of :func:`turning`."""
    fixed, by_cosine, by_sine = parts.unbind()
    angle = angle[..., None, None]
    return torch.addcmul(torch.addcmul(fixed, angle.cos(), by_cosine), angle.sin(), by_sine)


def vector_from_rotation(rotation: Tensor) -> Tensor:
    """Rotation vector (..., 3) in radians of a rotation (..., 3, 3)."""
    import roma  # it takes 1.6 s to import, and environments do without

    return roma.rotmat_to_rotvec(rotation)


def motion_vector(rotation: Tensor) -> Tensor:
    """Rotation vector (..., 3) of a turn well below half a revolution (..., 3, 3), as between two control steps.

    Cheaper than :func:`vector_from_rotation` and differentiable at rest; not for angles near pi.
    """
    parts = rotation.flatten(-2) @ _SKEW_AND_TRACE.to(rotation)
    sine_axis, cosine = parts[..., :3], parts[..., 3:] - 0.5
    sine = torch.linalg.vector_norm(sine_axis, dim=-1, keepdim=True).clamp_min(_SMALL_ANGLE)
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
