"""Pushing a horizontal bar, such as a drawer's handle, with the Panda's shut fingers. Metres, base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwm_gym.robots import panda
from pwm_gym.skills.motion import servo

__all__ = ["Push"]

_AHEAD = 0.045  # of the bar, where the tool goes down
_FARTHEST = 0.09  # ahead of the bar, from where it may go down
_NEAREST = 0.024  # ahead of the bar's middle, from where it may go down
_TOUCHING = 0.010  # ahead of it, at the least, where fingers push on it
_ASIDE = 0.03  # along the bar
_LEVEL = 0.008  # over the bar's height, from where fingers that are not there yet push
_PUSHING = 0.020  # over it, to where they go on pushing
_LOW = 0.03  # below the clearance, from where the tool rises before it moves sideways
_BEYOND = 0.06  # behind the bar, where it is told to go: the lag makes it less


@dataclass(frozen=True)
class Push:
    """Rise, go over the bar to its far side, down, and push."""

    clearance: float
    """Height of the tool over the bar at which it passes over what there is."""
    opening: float
    """Distance of the pads while it rises from what it may have held."""
    speed: float = 0.03
    """Longest translation asked for in a step."""

    def act(self, poses: np.ndarray, bar: np.ndarray, ahead: np.ndarray) -> np.ndarray:
        """Action (7,) that pushes a bar against its normal.

        Args:
            poses: (E, 7).
            bar: its middle (3,).
            ahead: horizontal unit vector (3,) from the bar to the side that is pushed on.
        """
        tool = panda.tool_pose(poses)
        along = np.cross([0.0, 0.0, 1.0], ahead)
        offset = tool[:3] - bar
        before, height = float(offset @ ahead), float(offset[2])
        amid = abs(float(offset @ along)) < _ASIDE
        touching = _TOUCHING < before <= _NEAREST and height < _PUSHING
        facing = _NEAREST < before < _FARTHEST
        target, gripper = bar + _AHEAD * ahead, -1.0
        if amid and (touching or (facing and height < _LEVEL)):
            target = bar - _BEYOND * ahead
        elif not (amid and facing):
            target[2] += self.clearance
            if height < self.clearance - _LOW:
                target[:2] = tool[:2]
                gripper = panda.gripper_command(self.opening)
        return servo(panda.PANDA, tool, target, along, self.speed, gripper)
