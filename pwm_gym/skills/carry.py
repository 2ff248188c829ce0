"""Carrying a held object over the edge of what it is put into. Metres, base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwm_gym.robots import panda
from pwm_gym.skills.motion import servo

__all__ = ["Carry"]

_BEGUN = 0.93  # of the clearance, below which the object counts as being lowered
_LOWERING = 2.5  # times as far beside the place as when it begins, it may then be
_LOW = 0.02  # below the clearance, from where it is lifted before it is moved sideways


@dataclass(frozen=True)
class Carry:
    """Lift, carry over the place, lower."""

    clearance: float
    """Height over the place at which the object is carried."""
    speed: float = 0.03
    """Longest translation asked for in a step."""
    beside: float = 0.008
    """Distance beside the place within which the object is lowered."""

    def act(self, poses: np.ndarray, position: np.ndarray, place: np.ndarray, closing: np.ndarray) -> np.ndarray:
        """Action (7,) that brings the held object to its place.

        Args:
            poses: (E, 7).
            position: of the object (3,).
            place: for it (3,).
            closing: direction (3,) along which the fingers shall lie.
        """
        tool = panda.tool_pose(poses)
        offset = place - position
        over = _LOWERING if -offset[2] < _BEGUN * self.clearance else 1.0
        if np.hypot(*offset[:2]) > over * self.beside:
            offset[2] += self.clearance
            if offset[2] > _LOW:
                offset[:2] = 0.0
        return servo(panda.PANDA, tool, tool[:3] + offset, closing, self.speed, gripper=-1.0)
