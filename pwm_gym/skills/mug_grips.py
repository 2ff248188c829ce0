"""Holding a mug from above: by its wall, away from its handle, or about its body. Metres, base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.sim.mugs import Mug
from pwm_gym.skills.pinch import Pinch

__all__ = ["MugGrip", "body_grip", "fits_body", "rim_grip"]

_BELOW_RIM = 0.016  # where the wall is held
_RIM_WIDE = 0.032  # between the pads on the way down; wider, a finger would meet the mug's other side
_RIM_RELEASED = 0.026
_BELOW_TOP = 0.022  # where the body is held
_EASE, _RELEASED = 0.010, 0.006  # wider than the body on the way down, if the gripper is; and when it is let go
_SUNK, _LOOSE = 0.008, 0.002  # narrower and wider than the body, where it counts as held
_WIDEST = 0.080  # the open gripper
_LEAST_EASE = 0.008
_HOVER = 0.12  # over the place, from where the fingers come down


@dataclass(frozen=True)
class MugGrip:
    """One way to hold a mug where it is."""

    pinch: Pinch
    """The grasp of it."""
    place: np.ndarray
    """Of the tool (3,)."""
    closing: np.ndarray
    """Horizontal direction (3,) along which the fingers close."""
    released: float
    """Distance of the pads when they have left the mug."""


def rim_grip(mug: Mug, pose: np.ndarray, side: np.ndarray, tool: np.ndarray, speed: float) -> MugGrip:
    """By the wall, which the fingers close on along ``side``.

    Args:
        mug: its sizes.
        pose: its pose (7,).
        side: horizontal direction (3,).
        tool: tool pose (7,).
        speed: longest translation asked for in a step.
    """
    handle = float(_handle(pose) @ side)
    to_tool = float((tool[:3] - pose[:3]) @ side)
    away = -handle if abs(handle) > 0.4 else to_tool  # either side will do where the handle points across
    out = np.copysign(mug.radius - 0.5 * mug.wall, away)
    place = pose[:3] + out * side + np.array([0.0, 0.0, 0.5 * mug.height - _BELOW_RIM])
    return MugGrip(Pinch((0.003, 0.011), _RIM_WIDE, _HOVER, speed), place, side, _RIM_RELEASED)


def body_grip(mug: Mug, pose: np.ndarray, speed: float) -> MugGrip:
    """About its middle, across its handle; arguments as of :func:`rim_grip`."""
    width = 2.0 * mug.radius
    pinch = Pinch((width - _SUNK, width + _LOOSE), min(width + _EASE, _WIDEST), _HOVER, speed)
    place = pose[:3] + np.array([0.0, 0.0, 0.5 * mug.height - _BELOW_TOP])
    return MugGrip(pinch, place, np.cross([0.0, 0.0, 1.0], _handle(pose)), width + _RELEASED)


def fits_body(mug: Mug) -> bool:
    """Whether the open gripper is wide enough to go about it."""
    return 2.0 * mug.radius + _LEAST_EASE <= _WIDEST


def _handle(pose: np.ndarray) -> np.ndarray:
    """Direction (3,) to the handle of a mug at pose (7,)."""
    return Rotation.from_quat(pose[3:], scalar_first=True).apply([1.0, 0.0, 0.0])
