"""Putting a lid on a box between two hands: each phase is told from the poses alone. Metres, base frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pwm_gym.robots import two_hands
from pwm_gym.robots.two_hands import FACE, SIDES, SIGN
from pwm_gym.scene.poses import rotation
from pwm_gym.sim.lidded_box import GRIP_HEIGHT, LID_HALF, ON_BOX, SQUEEZE
from pwm_gym.skills.two_hands import FLAT, Reach, act

__all__ = ["PutLid"]

_UP = np.array([0.0, 0.0, 1.0])
_OUTSIDE = 0.060  # between hand and lid, where a hand comes down
_FARTHEST = 0.10  # from where a hand beside the lid may go in
_INWARD = 0.025  # past the contact, to where hands that come in are told to go
_PRESSING = 0.007  # gap of a hand that holds
_LEVEL, _BESIDE = 0.015, 0.025  # over or under the grip's height, and along the side, within which a hand goes in
_CLEARANCE = 0.13  # of the lid's middle over its place, at which it is carried
_LOW = 0.02  # below the clearance, from where it is lifted before it is moved sideways
_OVER = (0.006, 0.03)  # metres beside the box and radians of yaw within which it is lowered
_ASTRAY = 3.0  # times as far, from where it is lifted again before it is moved on
_SINK = 0.6  # share of the speed with which it is lowered
_SEATED = (0.013, 0.004)  # metres beside and over its place: it is on the box
_TRAVEL = 0.10  # of a tool over the grip's height, on its way over the lid
_TURN = 0.05  # radians of yaw that the hands are ahead of the lid


@dataclass(frozen=True)
class PutLid:
    """The next action for a scene of both hands' links, then box and lid."""

    poses: np.ndarray
    """(24, 7)."""
    speed: float
    """Longest translation asked for in a step."""

    def act(self) -> np.ndarray:
        """Action (24,)."""
        if self._seated:
            return self._leave()
        if all(-0.02 < self._gap(side) < _PRESSING and self._beside(side) for side in SIDES):
            return self._carry()
        return act(self.poses, {side: self._approach(side) for side in SIDES})

    # Phases -------------------------------------------------------------------------------------------------------

    def _approach(self, side: str) -> Reach:
        """High, over the place outside the lid's side, down; in, when both hands are there."""
        gap, offset = self._gap(side), self._from_grip(side)
        target = self._grip(side) + _OUTSIDE * self._ways_out[side]
        if self._ready(side):
            if all(self._ready(other) for other in SIDES):
                target = self._grip(side) - _INWARD * self._ways_out[side]
        elif abs(offset[0]) > _BESIDE or not 0.02 < gap < _FARTHEST:
            target = target + _TRAVEL * _UP
            low = offset[2] < _TRAVEL - 0.03
            if low and gap < _FARTHEST:  # out of the lid's way before anything else
                target = self._tools[side] + 0.05 * self._ways_out[side] + 0.05 * _UP
        return self._reach(side, target, self.speed)

    def _carry(self) -> np.ndarray:
        """Lift, carry over the box, lower; the hands keep pressing."""
        offset = self._place - self.poses[-1, :3]
        turn = _yaw(self.poses[-2]) - self._lid_yaw
        astray = max(np.hypot(*offset[:2]) / _OVER[0], abs(turn) / _OVER[1])
        height = -offset[2]
        if height < _CLEARANCE - _LOW and astray > _ASTRAY:
            offset[:2], turn = 0.0, 0.0  # up first
            offset[2] += _CLEARANCE
        elif astray > 1.0:
            offset[2] = min(_CLEARANCE - height, 0.0) if astray > _ASTRAY else 0.0
        sideways = min(1.0, self.speed / max(float(np.hypot(*offset[:2])), 1e-9))
        step = np.r_[sideways * offset[:2], np.clip(offset[2], -_SINK * self.speed, self.speed)]
        turn = float(np.clip(turn, -_TURN, _TURN))
        reaches = {}
        for side in SIDES:
            arm = self._grip(side) - self.poses[-1, :3]
            moved = step + np.cross(turn * _UP, arm)
            push = -SQUEEZE * self._ways_out[side]
            reaches[side] = Reach(
                self._grip(side) + moved, -_turned(self._ways_out[side], turn), self.speed, FLAT, push
            )
        return act(self.poses, reaches)

    def _leave(self) -> np.ndarray:
        """Outward, and stay there."""
        reaches = {}
        for side in SIDES:
            away = self._tools[side] + (_OUTSIDE - self._gap(side)) * self._ways_out[side]
            reaches[side] = self._reach(side, away, 0.6 * self.speed)
        return act(self.poses, reaches)

    def _reach(self, side: str, target: np.ndarray, speed: float) -> Reach:
        return Reach(target, -self._ways_out[side], speed, FLAT)

    # What the poses tell ------------------------------------------------------------------------------------------

    @cached_property
    def _tools(self) -> dict[str, np.ndarray]:
        return {side: two_hands.tool_pose(self.poses, side)[:3] for side in SIDES}

    @cached_property
    def _ways_out(self) -> dict[str, np.ndarray]:
        """Direction (3,) out of the lid's side that each hand holds."""
        return {side: _turned(np.array([0.0, SIGN[side], 0.0]), self._lid_yaw) for side in SIDES}

    def _grip(self, side: str) -> np.ndarray:
        """Where (3,) a tool holds the lid."""
        return self.poses[-1, :3] + (LID_HALF[1] + FACE) * self._ways_out[side] + GRIP_HEIGHT * _UP

    def _from_grip(self, side: str) -> np.ndarray:
        """Tool (3,) from there: along the lid's side, out of it, up."""
        offset, out = self._tools[side] - self._grip(side), self._ways_out[side]
        return np.array([out[1] * offset[0] - out[0] * offset[1], offset @ out, offset[2]])

    def _gap(self, side: str) -> float:
        """Between a hand and the lid's side."""
        return float(self._from_grip(side)[1])

    def _beside(self, side: str) -> bool:
        """Whether a hand is beside the lid, at its height."""
        along, _, height = self._from_grip(side)
        return bool(abs(along) < 2 * _BESIDE and abs(height) < 2 * _LEVEL)

    def _ready(self, side: str) -> bool:
        """Whether a hand may go in."""
        along, gap, height = self._from_grip(side)
        return bool(abs(along) < _BESIDE and abs(height) < _LEVEL and gap < _FARTHEST)

    @cached_property
    def _lid_yaw(self) -> float:
        return _yaw(self.poses[-1])

    @cached_property
    def _place(self) -> np.ndarray:
        """The lid's place (3,) on the box."""
        return self.poses[-2, :3] + ON_BOX * _UP

    @cached_property
    def _seated(self) -> bool:
        offset = self.poses[-1, :3] - self._place
        return bool(np.hypot(*offset[:2]) < _SEATED[0] and abs(offset[2]) < _SEATED[1])


def _yaw(pose: np.ndarray) -> float:
    x, y, _ = rotation(pose).apply([1.0, 0.0, 0.0])
    return float(np.arctan2(y, x))


def _turned(direction: np.ndarray, yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([c * direction[0] - s * direction[1], s * direction[0] + c * direction[1], direction[2]])
