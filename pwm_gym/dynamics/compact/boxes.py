"""Signed distances of points to boxes about the origin.

Coordinates are three tensors: reductions over a dimension of three take several times as long on a CPU.
"""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["Coordinates", "box_depth", "box_gap", "box_gap_and_way", "coordinates", "turned"]

Coordinates = tuple[Tensor, Tensor, Tensor]
"""Of vectors: x, y and z, metres, of equal shapes."""


def coordinates(vectors: Tensor, dim: int) -> Coordinates:
    """The three places of ``vectors`` along ``dim``."""
    x, y, z = vectors.unbind(dim)
    return x, y, z


def box_depth(points: Coordinates, half: Coordinates) -> Tensor:
    """Largest coordinate by which points are beyond their box, negative inside: cheaper, and as good to compare."""
    return _deepest(_beyond(points, half))


def box_gap(points: Coordinates, half: Coordinates) -> Tensor:
    """Signed distance of points to boxes with half their sides, negative inside; the two broadcast."""
    return _gap(_beyond(points, half))[0]


def box_gap_and_way(points: Coordinates, half: Coordinates) -> tuple[Tensor, Coordinates]:
    """The same, and the vectors of that length.

    They lead from the box's surface to a point outside, and from a point inside to the nearest face.
    """
    beyond = _beyond(points, half)
    gap, outside, deepest, inside = _gap(beyond)
    way = []
    for place, over, out in zip(points, beyond, outside, strict=True):
        face = 1.0 + (over - deepest).sign()  # 1 at the nearest one: comparisons take longer
        way.append(place.sign() * (out - inside * face))
    return gap, (way[0], way[1], way[2])


def turned(rotation: Tensor, vectors: Coordinates) -> Coordinates:
    """Vectors (..., n) turned by rotations (..., 3, 3); a product of so few rows takes three times as long."""
    x, y, z = vectors
    rows = []
    for row in rotation.unbind(-2):
        a, b, c = row.unsqueeze(-2).unbind(-1)  # (..., 1)
        rows.append(torch.addcmul(torch.addcmul(a * x, b, y), c, z))
    return rows[0], rows[1], rows[2]


def _beyond(points: Coordinates, half: Coordinates) -> Coordinates:
    x, y, z = (place.abs() - side for place, side in zip(points, half, strict=True))
    return x, y, z


def _deepest(beyond: Coordinates) -> Tensor:
    return torch.maximum(torch.maximum(beyond[0], beyond[1]), beyond[2])


def _gap(beyond: Coordinates) -> tuple[Tensor, Coordinates, Tensor, Tensor]:
    """Signed distance, how far outside along each axis, the largest of ``beyond``, and that where it is negative."""
    deepest = _deepest(beyond)
    x, y, z = (over.clamp_min(0.0) for over in beyond)
    inside = deepest.clamp_max(0.0)
    squares = torch.addcmul(torch.addcmul(x * x, y, y), z, z)
    return squares.clamp_min(1e-12).sqrt() + inside, (x, y, z), deepest, inside
