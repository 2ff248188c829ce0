"""A box and the lid that goes over its rim, carried by both hands. Metres.

Both frames lie in the middle of the solid's extents, z up.
"""

from __future__ import annotations

from pwm_gym.sim.shapes import Box, Shape

__all__ = ["BESIDE", "BOX", "BOX_HALF", "GRIP_HEIGHT", "LID", "LID_HALF", "ON_BOX", "PRESSED", "SQUEEZE"]

_WALL, _PLATE = 0.008, 0.006

BOX_HALF = (0.098, 0.088, 0.050)
"""Half the box's sides."""
LID_HALF = (0.120, 0.110, 0.028)
"""Half the lid's: its skirt goes 5 cm down, 14 mm beside the box (4 mm does not fit two hands)."""
ON_BOX = BOX_HALF[2] + _PLATE - LID_HALF[2]
"""Height of a seated lid's middle over the box's."""
GRIP_HEIGHT = 0.024
"""Of the tools over the lid's middle, where hands hold it."""
PRESSED = (-0.010, 0.006)
"""Gaps between a hand and the lid's side from and to which it holds the lid."""
SQUEEZE = 0.014
"""By which hands are told to go further inward than the lid in every step; more of it drags both hands away."""
BESIDE = 0.06
"""Of a tool over or under the lid's middle, at most, of a hand that is beside the lid."""


def _sides(half: tuple[float, float, float], low: float, high: float) -> tuple[Shape, ...]:
    """Four walls between two heights."""
    x, y, _ = half
    height, middle = high - low, 0.5 * (low + high)
    return (
        *(Box((2 * x, _WALL, height), (0.0, side * (y - 0.5 * _WALL), middle)) for side in (-1.0, 1.0)),
        *(Box((_WALL, 2 * y - 2 * _WALL, height), (side * (x - 0.5 * _WALL), 0.0, middle)) for side in (-1.0, 1.0)),
    )


BOX: tuple[Shape, ...] = (
    *_sides(BOX_HALF, -BOX_HALF[2], BOX_HALF[2]),
    Box((2 * BOX_HALF[0], 2 * BOX_HALF[1], _PLATE), (0.0, 0.0, -BOX_HALF[2] + 0.5 * _PLATE)),
)
"""Walls and floor."""
LID: tuple[Shape, ...] = (
    *_sides(LID_HALF, -LID_HALF[2], LID_HALF[2] - _PLATE),
    Box((2 * LID_HALF[0], 2 * LID_HALF[1], _PLATE), (0.0, 0.0, LID_HALF[2] - 0.5 * _PLATE)),
)
"""Skirt and plate."""
