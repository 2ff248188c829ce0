"""A cabinet with one deep drawer for two hands: its boxes, its joint and its handle. Metres.

Frames as those of :mod:`pwm_gym.sim.cabinet`. A whole hand fits between the handle's bar and the front, beside the
middle, so that the other hand reaches into the tray.
"""

from __future__ import annotations

from pwm_gym.scene.joint import Joint
from pwm_gym.sim.mugs import Mug
from pwm_gym.sim.shapes import Box

__all__ = [
    "CABINET",
    "CABINET_HALF",
    "DRAWER",
    "DRAWER_FROM",
    "DRAWER_JOINT",
    "DRAWER_TO",
    "FRONT",
    "HANDLE",
    "HANDLE_WIDTH",
    "MUG",
    "OPENED",
    "PLACE",
    "STROKE",
    "TRAY",
    "TRAY_FLOOR",
]

CABINET_HALF = (0.12, 0.14, 0.075)
"""Half its sides."""
STROKE = 0.18
"""Way of the drawer."""
OPENED = 0.14
"""Way of the drawer from which it counts as open."""
HANDLE_WIDTH = 0.016
"""Thickness of the handle's bar, behind which a hand hangs."""
MUG = Mug(radius=0.030, height=0.090)
"""What is put into it."""

_WALL, _GAP, _TRAY_WALL = 0.008, 0.003, 0.006
_TRAY_HEIGHT = 0.044  # of walls with their floor
_BAR_LENGTH = 0.136
_BAR_AHEAD = 0.064  # of the front: 4 cm are left for a hand
_BAR_ASIDE = -0.060  # to the left hand, which faces the cabinet
_BAR_HEIGHT = 0.030  # over the cabinet's middle: the palm then stays over the front
_X, _Y, _Z = CABINET_HALF
_DEPTH, _WIDTH = _X - _WALL - _GAP, _Y - _WALL - _GAP
_BOTTOM = -_Z + _WALL + _GAP
_ORIGIN = _BOTTOM + 0.5 * _TRAY_HEIGHT

DRAWER_JOINT = Joint("prismatic", "cabinet", (0.0, 0.0, _ORIGIN, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0, STROKE)
"""Of the drawer on an entity called ``cabinet``."""

CABINET = (
    Box((2 * _X, 2 * _Y, _WALL), (0.0, 0.0, -_Z + 0.5 * _WALL)),
    Box((2 * _X, 2 * _Y, _WALL), (0.0, 0.0, _Z - 0.5 * _WALL)),
    Box((2 * _X, _WALL, 2 * _Z), (0.0, -_Y + 0.5 * _WALL, 0.0)),
    Box((2 * _X, _WALL, 2 * _Z), (0.0, _Y - 0.5 * _WALL, 0.0)),
    Box((_WALL, 2 * _Y, 2 * _Z), (-_X + 0.5 * _WALL, 0.0, 0.0)),
)
"""Bottom, top, sides and back, in the cabinet's frame."""

_HALF_HEIGHT = 0.5 * _TRAY_HEIGHT
_LENGTH, _MIDDLE = _X + _DEPTH, 0.5 * (_X - _DEPTH)
_PANEL = 2 * (_Z - _WALL - _GAP)
HANDLE = (_X + _BAR_AHEAD, _BAR_ASIDE, _BAR_HEIGHT - _ORIGIN)
"""Middle of the handle's bar in the drawer's frame; the bar lies along y."""
FRONT = _X
"""Foremost x of the front panel in the drawer's frame."""
_POST = (_BAR_AHEAD + _WALL, HANDLE_WIDTH, HANDLE_WIDTH)

DRAWER = (
    Box((_LENGTH, 2 * _WIDTH, _TRAY_WALL), (_MIDDLE, 0.0, -_HALF_HEIGHT + 0.5 * _TRAY_WALL)),
    Box((_LENGTH, _TRAY_WALL, _TRAY_HEIGHT), (_MIDDLE, -_WIDTH + 0.5 * _TRAY_WALL, 0.0)),
    Box((_LENGTH, _TRAY_WALL, _TRAY_HEIGHT), (_MIDDLE, _WIDTH - 0.5 * _TRAY_WALL, 0.0)),
    Box((_TRAY_WALL, 2 * _WIDTH, _TRAY_HEIGHT), (-_DEPTH + 0.5 * _TRAY_WALL, 0.0, 0.0)),
    Box((_WALL, 2 * _WIDTH, _PANEL), (_X - 0.5 * _WALL, 0.0, -_ORIGIN)),
    Box((HANDLE_WIDTH, _BAR_LENGTH, HANDLE_WIDTH), HANDLE),
    *(
        Box(_POST, (HANDLE[0] - 0.5 * _POST[0], HANDLE[1] + side * 0.5 * (_BAR_LENGTH - HANDLE_WIDTH), HANDLE[2]))
        for side in (-1.0, 1.0)
    ),
)
"""Tray, front panel and handle, in the drawer's frame."""

DRAWER_FROM = (-_DEPTH, -_WIDTH, -_HALF_HEIGHT)
"""Its least x, y and z in its own frame."""
DRAWER_TO = (HANDLE[0] + 0.5 * HANDLE_WIDTH, _WIDTH, 0.5 * _PANEL - _ORIGIN)
"""Its greatest ones."""
TRAY = ((-_DEPTH + _TRAY_WALL, -_WIDTH + _TRAY_WALL), (_X - _WALL, _WIDTH - _TRAY_WALL))
"""Lowest and highest x and y within the tray, in the drawer's frame."""
TRAY_FLOOR = -_HALF_HEIGHT + _TRAY_WALL
"""Height of the tray's floor in the drawer's frame."""
PLACE = (_X - 0.075, 0.035, TRAY_FLOOR)
"""Where on the floor the mug is put: before the cabinet when it is open, away from the hand at the handle."""
