"""Where a rigid body is, told by parts of it whose centres are at known places of its frame."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.terms import Info, Place

__all__ = ["fitted", "fixed_place"]


def fitted(points: Points, places: Mapping[str, tuple[float, float, float]]) -> tuple[Tensor, Tensor]:
    """Rotation (B, 3, 3) and position (B, 3) of a frame, by least squares (Kabsch).

    Args:
        points: clouds.
        places: entity -> where its centre is in the frame, metres; at least three that are not in a line.
    """
    seen = torch.stack([contacts.centre(points, name) for name in places], -2)  # (B, K, 3)
    known = seen.new_tensor([*places.values()])
    middle, own = seen.mean(-2), known.mean(-2)
    u, _, v = torch.linalg.svd((seen - middle.unsqueeze(-2)).transpose(-1, -2) @ (known - own))
    mirrored = torch.linalg.det(u @ v)  # -1 where the best fit would be a reflection
    u = torch.cat([u[..., :2], u[..., 2:] * mirrored[..., None, None]], -1)
    rotation = u @ v
    return rotation, middle - rotation @ own


def fixed_place(places: Mapping[str, tuple[float, float, float]], place: tuple[float, float, float]) -> Place:
    """The place (B, 3) that is at ``place`` in the frame of :func:`fitted`, metres."""

    def found(points: Points, info: Info) -> Tensor:
        rotation, position = fitted(points, places)
        return position + rotation @ rotation.new_tensor(place)

    return found
