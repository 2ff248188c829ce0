"""Rigid motions, batched over any leading dimensions.

A pose is a (4, 4) homogeneous matrix that takes canonical coordinates to the world frame, or its (7,) form
``x y z qw qx qy qz`` (metres, unit quaternion). A twist is (6,): translation (metres), rotation vector (radians).
"""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor

__all__ = [
    "inverse",
    "make_pose",
    "matrix_from_pose7",
    "motion_vector",
    "pose7_from_matrix",
    "rotation_about",
    "rotation_angle",
    "rotation_from_vector",
    "rotation_parts",
    "transform",
    "vector_from_rotation",
]

_SMALL_ANGLE = 1e-6  # radians; below it x/sin(x) takes its limit
_EYE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_BOTTOM = ((0.0, 0.0, 0.0, 1.0),)
_CROSS = (  # of a vector (3,): the matrix (9,) of the cross product with it
    (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0),
    (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)
_SINE_AND_COSINE = (  # of a rotation (9,): its axis times the sine (3,), and the cosine and a half
    (0.0, 0.0, 0.0, 0.5),
    (0.0, 0.0, -0.5, 0.0),
    (0.0, 0.5, 0.0, 0.0),
    (0.0, 0.0, 0.5, 0.0),
    (0.0, 0.0, 0.0, 0.5),
    (-0.5, 0.0, 0.0, 0.0),
    (0.0, -0.5, 0.0, 0.0),
    (0.5, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.5),
)


@cache
def _made(values: tuple[tuple[float, ...], ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    with torch.inference_mode(False):  # a planner may be the first to ask, and a training the next
        return torch.tensor(values, dtype=dtype, device=device)


def _constant(values: tuple[tuple[float, ...], ...], like: Tensor) -> Tensor:
    """A constant on the device of ``like``, made once."""
    return _made(values, like.dtype, like.device)


def make_pose(rotation: Tensor, translation: Tensor) -> Tensor:
    """Pose (..., 4, 4) of a rotation (..., 3, 3) and a translation (..., 3)."""
    top = torch.cat([rotation, translation.unsqueeze(-1)], -1)
    return torch.cat([top, _constant(_BOTTOM, top).expand(*top.shape[:-2], 1, 4)], -2)


def inverse(pose: Tensor) -> Tensor:
    """Inverse (..., 4, 4) of a rigid pose (..., 4, 4)."""
    rotation = pose[..., :3, :3].transpose(-1, -2)
    return make_pose(rotation, -(rotation @ pose[..., :3, 3:]).squeeze(-1))


def transform(pose: Tensor, points: Tensor) -> Tensor:
    """Points (..., n, 3) moved by poses (..., 4, 4).

    In memory the result runs along its points, which is faster to form and to reduce (``docs/performance.md``): it is
    not contiguous.
    """
    rotation, shift, columns = pose[..., :3, :3], pose[..., :3, 3:], points.transpose(-1, -2)
    if pose.ndim == points.ndim == 3 and len(pose) == len(points):  # without a second result in memory
        return torch.baddbmm(shift, rotation, columns).transpose(-1, -2)
    return (rotation @ columns + shift).transpose(-1, -2)


def rotation_from_vector(vector: Tensor) -> Tensor:
    """Rotation (..., 3, 3) of a rotation vector (..., 3) in radians (Rodrigues' formula).

    Differentiable everywhere, at rest once.
    """
    cross = (vector @ _constant(_CROSS, vector)).unflatten(-1, (3, 3))
    half_turns = torch.linalg.vector_norm(vector, dim=-1)[..., None, None] / torch.pi  # sinc's unit
    linear = torch.addcmul(_constant(_EYE, vector), torch.sinc(half_turns), cross)
    return torch.addcmul(linear, torch.sinc(0.5 * half_turns).square(), cross @ cross, value=0.5)


def rotation_parts(axes: Tensor) -> Tensor:
    """Parts (3, ..., 3, 3) of turns about unit axes (..., 3): fixed, times the angle's cosine, and times its sine."""
    along = axes.unsqueeze(-1) * axes.unsqueeze(-2)
    return torch.stack([along, _constant(_EYE, axes) - along, (axes @ _constant(_CROSS, axes)).unflatten(-1, (3, 3))])


def rotation_about(parts: Tensor, angle: Tensor) -> Tensor:
    """Rotations (..., 3, 3) by angles (...) in radians about axes of which there are parts (:func:`rotation_parts`).

    Parts may be multiplied by constant matrices, or poses (3, ..., 4, 4); then so is the result.
    """
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
    parts = rotation.flatten(-2) @ _constant(_SINE_AND_COSINE, rotation)
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
