"""A coffee machine with a holder for a pod and a hinged lid: its boxes and its joint. Metres, radians.

The machine's frame lies on the holder's axis at the height of what it stands on, z up, x to its front. The lid's frame
lies on its hinge; shut, it has the machine's axes.
"""

from __future__ import annotations

import math

from pwm_gym.scene.joint import Joint
from pwm_gym.sim.shapes import Box, Cylinder

__all__ = [
    "HOLDER_FLOOR",
    "LID",
    "LID_JOINT",
    "LID_LENGTH",
    "MACHINE",
    "MACHINE_FROM",
    "MACHINE_TO",
    "MUG_AHEAD",
    "OPEN_ANGLE",
    "POD",
    "POD_HEIGHT",
    "POD_RADIUS",
    "RIM",
    "SEATED",
    "SHUT_ANGLE",
    "TOWER_TOP",
]

POD_RADIUS, POD_HEIGHT = 0.022, 0.040
RIM = 0.100
"""Height of the holder's rim."""
HOLDER_FLOOR = RIM - 0.026
"""Height of the floor that the pod stands on."""
OPEN_ANGLE = math.radians(105)
"""Of the lid, which its weight then keeps open."""
SHUT_ANGLE = math.radians(5)
"""At most which it counts as shut."""
SEATED = (0.006, 0.008)
"""Of a pod that counts as put in: at most so far beside the holder's axis, and over its floor."""
LID_LENGTH = 0.085
MUG_AHEAD = 0.175
"""Where a mug stands, before the holder's axis: under the holder there is no room for a hand."""

_CLEARANCE = 0.003  # between pod and holder
_SIDES = 16
_WALL = 0.005
_PLATE = (0.016, 0.003)  # length and thickness of the funnel's plates
_SLOPE = math.radians(40)
_LIP = 0.0015  # by which the funnel begins outside the holder's inner side
_HINGE = (-0.050, 0.0, RIM + 0.024)
_LID_WIDTH, _LID_HEIGHT = 0.060, 0.008
TOWER_TOP = 0.118
"""Height of the highest part, which stands behind the holder."""
_TOWER = (-0.130, -0.056)  # from and to along x
_FOOT = 0.070  # side of what the holder stands on

LID_JOINT = Joint("revolute", "machine", (*_HINGE, 1.0, 0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 0.0, OPEN_ANGLE)
"""Of the lid on an entity called ``machine``; 0 is shut."""

_INNER = POD_RADIUS + _CLEARANCE


def _ring() -> tuple[Box, ...]:
    """The holder's wall, and the funnel on it."""
    found = []
    wide = 2 * math.tan(math.pi / _SIDES)
    length, thick = _PLATE
    across = _INNER + _LIP + 0.5 * length * math.cos(_SLOPE)
    height = RIM + 0.5 * length * math.sin(_SLOPE) - 0.5 * thick / math.cos(_SLOPE)
    for k in range(_SIDES):
        yaw = 2 * math.pi * k / _SIDES
        cos, sin = math.cos(yaw), math.sin(yaw)
        middle = _INNER + 0.5 * _WALL
        wall = (_WALL, wide * (_INNER + _WALL), RIM - HOLDER_FLOOR + 0.002)  # begins below the floor
        found.append(Box(wall, (middle * cos, middle * sin, 0.5 * (RIM + HOLDER_FLOOR - 0.002)), yaw))
        plate = (length, wide * (_INNER + length * math.cos(_SLOPE)), thick)
        found.append(Box(plate, (across * cos, across * sin, height), yaw, -_SLOPE))
    return tuple(found)


MACHINE = (
    Box((_FOOT, _FOOT, HOLDER_FLOOR), (0.0, 0.0, 0.5 * HOLDER_FLOOR)),
    Box((_TOWER[1] - _TOWER[0], 0.100, TOWER_TOP), (0.5 * (_TOWER[0] + _TOWER[1]), 0.0, 0.5 * TOWER_TOP)),
    Box((0.04, 0.05, 0.02), (-0.045, 0.0, 0.01)),
    *_ring(),
)
"""Foot, tower, what joins them, and the holder, in the machine's frame."""
MACHINE_FROM = _TOWER[0]
"""Its least x."""
MACHINE_TO = _INNER + _LIP + _PLATE[0] * math.cos(_SLOPE) + 0.5 * _PLATE[1] * math.sin(_SLOPE)
"""Its greatest x: the funnel's edge."""

LID = (Box((LID_LENGTH, _LID_WIDTH, _LID_HEIGHT), (0.5 * LID_LENGTH, 0.0, 0.0)),)
"""In its own frame."""
POD = (Cylinder(POD_RADIUS, POD_HEIGHT),)
"""In its own frame, which lies in its middle."""
