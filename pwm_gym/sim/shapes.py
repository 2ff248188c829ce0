"""Solids made of boxes and cylinders, which a simulator collides."""

from __future__ import annotations

import math
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
    pitch: float = 0.0
    """Turn about its own y, after the yaw: its x then points down."""

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Its turn, wxyz."""
        about_z = math.cos(0.5 * self.yaw), math.sin(0.5 * self.yaw)
        about_y = math.cos(0.5 * self.pitch), math.sin(0.5 * self.pitch)
        return (
            about_z[0] * about_y[0],
            -about_z[1] * about_y[1],
            about_z[0] * about_y[1],
            about_z[1] * about_y[0],
        )


@dataclass(frozen=True)
class Cylinder:
    """A cylinder of a solid whose axis is z, in the solid's frame. Metres."""

    radius: float
    height: float
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)


Shape = Box | Cylinder
