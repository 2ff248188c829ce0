"""Solids made of boxes and cylinders, which a simulator collides."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Box", "Cylinder", "Shape"]


@dataclass(frozen=True)
class Box:
    """A box of a solid, in the solid's frame. Metres and radians."""

    size: tuple[float, float, float]
    """Sides along its own axes."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    """Turn about z."""


@dataclass(frozen=True)
class Cylinder:
    """A cylinder of a solid whose axis is z, in the solid's frame. Metres."""

    radius: float
    height: float
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)


Shape = Box | Cylinder
