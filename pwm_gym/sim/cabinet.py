"""A low cabinet with one drawer: its boxes, its joint and its handle. Metres.

The cabinet's frame lies in its middle, z up, x to its open front. The drawer's frame lies in the middle of its tray's
height, and has the cabinet's axes.
"""

from __future__ import annotations

from pwm_gym.scene.joint import Joint
from pwm_gym.sim.shapes import Box

__all__ = [
    "CABINET",
    "CABINET_HALF",
    "DRAWER",
    "DRAWER_FROM",
    "DRAWER_JOINT",
    "DRAWER_TO",
    "HANDLE",
    "HANDLE_WIDTH",
    "OPENED",
    "PLACE",
    "STROKE",
    "TRAY",
    "TRAY_FLOOR",
]

CABINET_HALF = (0.11, 0.12, 0.0525)
"""Half its sides."""
STROKE = 0.16
"""Way of the drawer."""
OPENED = 0.12
"""Way of the drawer from which it counts as open."""
HANDLE_WIDTH = 0.012
"""Thickness of the handle's bar, which is grasped from above."""

_WALL = 0.008
_GAP = 0.003  # between drawer and cabinet
_TRAY_WALL = 0.006
_TRAY_HEIGHT = 0.044  # of walls with their floor
_BAR_LENGTH = 0.112
_BAR_AHEAD = 0.050  # of the front; at 32 and 42 mm the fingers jam between bar and front
_BAR_HEIGHT = 0.0235  # over the cabinet's middle: the hand then passes over the cabinet
_X, _Y, _Z = CABINET_HALF
_DEPTH, _WIDTH = _X - _WALL - _GAP, _Y - _WALL - _GAP  # from the middle to the tray's back and side
_BOTTOM = -_Z + _WALL + _GAP
_ORIGIN = _BOTTOM + 0.5 * _TRAY_HEIGHT  # height of the drawer's frame in the cabinet's

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
_LENGTH, _MIDDLE = _X + _DEPTH, 0.5 * (_X - _DEPTH)  # of the tray along x
_PANEL = 2 * (_Z - _WALL - _GAP)
HANDLE = (_X + _BAR_AHEAD, 0.0, _BAR_HEIGHT - _ORIGIN)
"""Middle of the handle's bar in the drawer's frame; the bar lies along y."""
_POST = (_BAR_AHEAD + _WALL, HANDLE_WIDTH, HANDLE_WIDTH)

DRAWER = (
    Box((_LENGTH, 2 * _WIDTH, _TRAY_WALL), (_MIDDLE, 0.0, -_HALF_HEIGHT + 0.5 * _TRAY_WALL)),
    Box((_LENGTH, _TRAY_WALL, _TRAY_HEIGHT), (_MIDDLE, -_WIDTH + 0.5 * _TRAY_WALL, 0.0)),
    Box((_LENGTH, _TRAY_WALL, _TRAY_HEIGHT), (_MIDDLE, _WIDTH - 0.5 * _TRAY_WALL, 0.0)),
    Box((_TRAY_WALL, 2 * _WIDTH, _TRAY_HEIGHT), (-_DEPTH + 0.5 * _TRAY_WALL, 0.0, 0.0)),
    Box((_WALL, 2 * _WIDTH, _PANEL), (_X - 0.5 * _WALL, 0.0, -_ORIGIN)),
    Box((HANDLE_WIDTH, _BAR_LENGTH, HANDLE_WIDTH), HANDLE),
    *(
        Box(_POST, (HANDLE[0] - 0.5 * _POST[0], side * 0.5 * (_BAR_LENGTH - HANDLE_WIDTH), HANDLE[2]))
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
PLACE = (_X - 0.083, 0.0, TRAY_FLOOR)
"""Where on the floor things are put: far enough before the cabinet for a hand that comes down when it is open."""
