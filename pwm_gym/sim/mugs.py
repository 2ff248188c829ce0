"""Mugs of several sizes with a handle, by name. Metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pwm_gym.errors import look_up
from pwm_gym.sim.shapes import Box, Cylinder, Shape

__all__ = ["MUGS", "TALL_MUG", "Mug", "get_mug"]

_SIDES = 16
_BASE = 0.002  # by which the floor stands out below the walls: fewer contacts with what it stands on
_GRIP = (0.008, 0.010)  # thickness and width of the handle


@dataclass(frozen=True)
class Mug:
    """A mug whose frame lies on its axis at half its height, z up, x to its handle."""

    radius: float
    """Of its outer side."""
    height: float
    wall: float = 0.005
    """Thickness of wall and floor."""
    reach: float = 0.026
    """How far its handle stands out."""

    def shapes(self) -> tuple[Shape, ...]:
        """Walls, floor and handle."""
        half = 0.5 * self.height
        middle = self.radius - 0.5 * self.wall
        side = (self.wall, 2 * self.radius * math.tan(math.pi / _SIDES), self.height - _BASE)
        turns = [2 * math.pi * k / _SIDES for k in range(_SIDES)]
        walls = [Box(side, (middle * math.cos(a), middle * math.sin(a), 0.5 * _BASE), a) for a in turns]
        floor = Cylinder(middle, self.wall, (0.0, 0.0, -half + 0.5 * self.wall))
        return (*walls, floor, *self._handle())

    def _handle(self) -> tuple[Box, Box, Box]:
        thick, wide = _GRIP
        low, high = -0.28 * self.height, 0.28 * self.height
        length = self.reach + 0.5 * self.wall  # begins amid the wall
        start = self.radius + self.reach
        bars = [Box((length, wide, thick), (start - 0.5 * length, 0.0, z)) for z in (low, high)]
        grip = Box((thick, wide, high - low + thick), (start - 0.5 * thick, 0.0, 0.0))
        return bars[0], bars[1], grip


MUGS = {
    f"mug_{1000 * radius:.0f}x{1000 * height:.0f}": Mug(radius, height)
    for radius in (0.032, 0.035, 0.038)
    for height in (0.060, 0.066, 0.072)
}
"""Name (radius x height in millimetres) -> mug."""
TALL_MUG = Mug(radius=0.030, height=0.090)
"""Of two hands: fingers and thumb hold it below its rim."""


def get_mug(name: str) -> Mug:
    """The mug called ``name``.

    Raises:
        UnknownNameError: listing the known mugs and the nearest one.
    """
    return look_up("mug", name, MUGS)
