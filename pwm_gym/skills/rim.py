"""Holding a mug by its wall, from above, away from its handle. Metres, base frame."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.sim.mugs import Mug
from pwm_gym.skills.pinch import Pinch

__all__ = ["BELOW_RIM", "RIM_RELEASED", "RIM_WIDE", "rim_pinch", "rim_place"]

BELOW_RIM = 0.016
"""Where the wall is held."""
RIM_WIDE = 0.032
"""Distance of the pads on the way down; wider, a finger would meet the mug's other side or what is behind it."""
RIM_RELEASED = 0.026
"""Distance of the pads when they have left the wall."""


def rim_pinch(speed: float) -> Pinch:
    """The grasp of a mug's wall; ``speed`` is the longest translation asked for in a step."""
    return Pinch((0.003, 0.011), RIM_WIDE, 0.12, speed)


def rim_place(mug: Mug, pose: np.ndarray, side: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """Place (3,) on the wall that the fingers close on.

    Args:
        mug: its sizes.
        pose: its pose (7,).
        side: horizontal direction (3,) along which the fingers close.
        tool: tool pose (7,).
    """
    turn = Rotation.from_quat(pose[3:], scalar_first=True)
    handle = float(turn.apply([1.0, 0.0, 0.0]) @ side)
    to_tool = float((tool[:3] - pose[:3]) @ side)
    away = -handle if abs(handle) > 0.4 else to_tool  # either side will do where the handle points across
    out = np.copysign(mug.radius - 0.5 * mug.wall, away)
    return pose[:3] + out * side + np.array([0.0, 0.0, 0.5 * mug.height - BELOW_RIM])
