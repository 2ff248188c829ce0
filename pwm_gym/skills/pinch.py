"""Closing the Panda's fingers on a narrow part from above: a handle's bar, a mug's wall. Metres, base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwm_gym.robots import panda
from pwm_gym.skills.motion import downward_turn, servo

__all__ = ["Pinch"]

_BESIDE = 0.006  # of the place, within which the tool descends
_ASKEW = 0.08  # radians, within which it does
_CENTRED = (0.006, 0.006)  # beside and above the place, within which the fingers shut
_BEGUN = (0.015, 0.015)  # the same, once they have begun to
_HELD = (0.018, 0.016)  # beside and above it: what counts as held when the fingers are as far apart as it is wide
_RISE = 0.02  # beside the place and below the hover height, from where the tool rises first


@dataclass(frozen=True)
class Pinch:
    """Hover over a place, turn the fingers, descend and shut."""

    width: tuple[float, float]
    """Least and greatest distance of the pads that tells that the part is between them."""
    opening: float
    """Distance of the pads on the way down."""
    hover: float
    """Height over the place from which the tool descends."""
    speed: float = 0.03
    """Longest translation asked for in a step."""

    def holds(self, poses: np.ndarray, place: np.ndarray) -> bool:
        """Whether the part at ``place`` (3,) is between the pads, for poses (E, 7)."""
        reach = place - panda.tool_pose(poses)[:3]
        near = np.hypot(*reach[:2]) < _HELD[0] and abs(reach[2]) < _HELD[1]
        return bool(near and self.width[0] < panda.opening(poses) < self.width[1])

    def act(self, poses: np.ndarray, place: np.ndarray, closing: np.ndarray) -> np.ndarray:
        """Action (7,) towards a grasp.

        Args:
            poses: (E, 7).
            place: (3,) where the tool shall be when the fingers shut.
            closing: direction (3,) along which they shall.
        """
        tool = panda.tool_pose(poses)
        reach = place - tool[:3]
        beside = float(np.hypot(*reach[:2]))
        askew = float(np.linalg.norm(downward_turn(tool, closing)))
        begun = panda.opening(poses) < self.opening - 0.004
        near = _BEGUN if begun else _CENTRED
        if beside < near[0] and abs(reach[2]) < near[1] and askew < 2 * _ASKEW:
            return servo(panda.PANDA, tool, place, closing, self.speed, gripper=-1.0)
        wide = panda.gripper_command(self.opening)
        above = place + [0.0, 0.0, self.hover]
        if beside < _BESIDE and askew < _ASKEW:
            above = place
        elif beside > _RISE and above[2] - tool[2] > _RISE:  # rise before moving sideways
            above[:2] = tool[:2]
        return servo(panda.PANDA, tool, above, closing, self.speed, gripper=wide)
