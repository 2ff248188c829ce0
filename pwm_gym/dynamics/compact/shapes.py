"""The points of a scene's entities that the model reads, and what the robot's links are told of theirs."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.compact.plan import Places

__all__ = ["LENGTH", "NEAR", "TOUCH", "LinkShapes", "Pooled", "Shapes"]

LENGTH, NEAR, TOUCH = 0.1, 0.01, 0.005
"""Metres that count as 1: of places, of what is near, of what touches."""


class Pooled(nn.Module):
    """A network of points, and what its largest and mean outputs tell."""

    def __init__(self, features: int, width: int, size: int) -> None:
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(features, width), nn.ReLU(inplace=True), nn.Linear(width, width), nn.ReLU(inplace=True)
        )
        self.out = nn.Linear(2 * width, size)

    def forward(self, rows: list[Tensor]) -> Tensor:
        """(B, F, C) of points' features: rows (B, F, k, n), all of which one large product takes."""
        features = torch.cat([row.permute(2, 0, 1, 3) for row in rows])  # (K, B, F, n)
        hidden = self.net(features.flatten(1).t()).unflatten(0, features.shape[1:])
        return self.out(torch.cat([hidden.amax(-2), hidden.mean(-2)], -1))


@dataclass(frozen=True)
class Shapes:
    """The points of each entity that are read, in its own frame."""

    points: Tensor
    """Homogeneous (B, P, 4, n): along the points in memory, which is faster to multiply and to reduce."""
    low: Tensor
    """Corner (B, P, 3) of the box around them."""
    high: Tensor
    """The opposite corner."""
    middles: Tensor
    """Mean points (B, P, 3)."""

    clouds: Tensor | None
    """More of the movers' points (B, F, 4, m), homogeneous, where contacts may look at them more closely."""

    @classmethod
    def of(cls, points: Tensor, movers: Places, clouds: Tensor | None) -> Shapes:
        """Of canonical points (B, P, n, 3), and larger clouds (B, F, m, 3) of the entities at ``movers``."""
        rows = _homogeneous(points)
        low, high = rows[:, :, :3].amin(-1), rows[:, :, :3].amax(-1)
        middles = rows[:, :, :3].mean(-1)
        if clouds is None:
            return cls(rows, low, high, middles, None)
        more = _homogeneous(clouds)
        low[:, movers], high[:, movers] = more[:, :, :3].amin(-1), more[:, :, :3].amax(-1)
        return cls(rows, low, high, middles, more)


def _homogeneous(points: Tensor) -> Tensor:
    """(..., 4, n) of points (..., n, 3)."""
    return nn.functional.pad(points.transpose(-1, -2), (0, 0, 0, 1), value=1.0)


class LinkShapes(nn.Module):
    """What the links' tokens are told of their shapes, and of how far they would enter the floor.

    Args:
        width: channels of the per-point network.
        size: channels of a token.
    """

    corners: Tensor

    def __init__(self, width: int, size: int) -> None:
        super().__init__()
        ends = torch.tensor([False, True])
        corners = torch.cartesian_prod(ends, ends, ends).t().contiguous()
        self.register_buffer("corners", corners, persistent=False)  # (3, 8)
        self.net = Pooled(7, width, size)

    def forward(self, shapes: Shapes, links: Tensor, links_next: Tensor, seen: Tensor, floor: float) -> Tensor:
        """(B, L, C).

        Args:
            shapes: of all entities, the links first.
            links: poses (B, L, 4, 4).
            links_next: the same one step later, as foreseen.
            seen: inverse pose (B, 3, 4) of the frame of reference.
            floor: its height, metres.
        """
        count = links.shape[1]
        corners = torch.where(self.corners, shapes.high[:, :count, :, None], shapes.low[:, :count, :, None])
        maps = torch.cat([seen.unsqueeze(1) @ links, links[:, :, 2:3], links_next[:, :, 2:3]], 2)  # (B, L, 5, 4)
        place, heights = (maps[..., :3] @ corners + maps[..., 3:]).split([3, 2], 2)
        heights = heights - floor
        return self.net(
            [
                place / LENGTH,
                heights[:, :, :1].clamp(-1, 1) / LENGTH,
                torch.tanh(heights / NEAR),
                torch.tanh(heights[:, :, 1:] / TOUCH),
            ]
        )
