"""Putting a mug into a cabinet's drawer with the Panda: open, put in, shut. Each phase is told from the poses alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots import panda
from pwm_gym.sim.cabinet import DRAWER_JOINT, HANDLE, HANDLE_WIDTH, PLACE, TRAY, TRAY_FLOOR
from pwm_gym.sim.mugs import Mug
from pwm_gym.skills.carry import Carry
from pwm_gym.skills.motion import servo
from pwm_gym.skills.pinch import Pinch
from pwm_gym.skills.push import Push

__all__ = ["CleanUp"]

_UP = np.array([0.0, 0.0, 1.0])
_PULLED, _OPEN, _SHUT = 0.15, 0.135, 0.005  # metres of the drawer's way
_BELOW_RIM = 0.016  # where the mug's wall is held
_WIDE = 0.032  # between the pads on the way down; wider, a finger would meet the mug's other side or the cabinet
_RELEASED = 0.026  # between the pads when they have left what they held
_CLEAR = 0.05  # over the handle, where the hand may turn
_ON_FLOOR = 0.004  # of the mug's bottom over the tray's floor
_IN_TRAY = 0.014  # the same, when the mug counts as put in
_NEAR = 0.02  # from where it was held: the tool has not left it yet


@dataclass(frozen=True)
class CleanUp:
    """The next action for a scene of hand, left finger, right finger, cabinet, drawer and mug."""

    poses: np.ndarray
    """(6, 7)."""
    mug: Mug
    speed: float
    """Longest translation asked for in a step, metres."""

    def act(self) -> np.ndarray:
        """Action (7,)."""
        if self._inside:
            return self._shut()
        rim = Pinch((0.003, 0.011), _WIDE, 0.12, self.speed)
        if rim.holds(self.poses, self._rim):
            return self._carry()
        bar = Pinch((HANDLE_WIDTH - 0.004, HANDLE_WIDTH + 0.004), _WIDE, 0.08, self.speed)
        if bar.holds(self.poses, self._bar) and self._opening < _PULLED:
            return self._move(self._bar + 0.05 * self._front, self._front, gripper=-1.0)
        if self._opening < _OPEN:
            return bar.act(self.poses, self._bar, self._front)
        if self._at_bar:
            return self._leave_bar()
        return rim.act(self.poses, self._rim, self._side)

    # Phases -------------------------------------------------------------------------------------------------------

    def _leave_bar(self) -> np.ndarray:
        """Let the handle go, then rise straight."""
        wide = panda.gripper_command(_WIDE)
        if panda.opening(self.poses) < _RELEASED:
            return self._move(self._tool[:3], self._front, wide)
        return self._move(self._tool[:3] + 0.1 * _UP, self._front, wide)

    def _carry(self) -> np.ndarray:
        """Bring the held mug over the drawer's edge into it."""
        place = self._in_drawer(PLACE) + 0.5 * self.mug.height * _UP
        return Carry(0.13, self.speed).act(self.poses, self.poses[5, :3], place, self._side)

    def _shut(self) -> np.ndarray:
        """Let the mug go, and push the drawer."""
        if self._opening < _SHUT:
            return self._move(self._tool[:3], self._side, gripper=-1.0)
        if panda.opening(self.poses) < _RELEASED and np.linalg.norm(self._rim - self._tool[:3]) < _NEAR:
            if self._height > _ON_FLOOR:
                return self._carry()
            return self._move(self._tool[:3], self._side, panda.gripper_command(_WIDE))
        return Push(0.12, _WIDE, self.speed).act(self.poses, self._bar, self._front)

    def _move(self, target: np.ndarray, closing: np.ndarray, gripper: float) -> np.ndarray:
        return servo(panda.PANDA, self._tool, target, closing, self.speed, gripper)

    # What the poses tell ------------------------------------------------------------------------------------------

    @cached_property
    def _tool(self) -> np.ndarray:
        return panda.tool_pose(self.poses)

    @cached_property
    def _drawer(self) -> Rotation:
        return Rotation.from_quat(self.poses[4, 3:], scalar_first=True)

    @cached_property
    def _front(self) -> np.ndarray:
        """Direction (3,) in which the drawer opens."""
        return self._drawer.apply([1.0, 0.0, 0.0])

    @cached_property
    def _side(self) -> np.ndarray:
        """Direction (3,) along the cabinet's front."""
        return self._drawer.apply([0.0, 1.0, 0.0])

    def _in_drawer(self, point: tuple[float, float, float]) -> np.ndarray:
        """Place (3,) of a point of the drawer's frame."""
        return self.poses[4, :3] + self._drawer.apply(point)

    @cached_property
    def _bar(self) -> np.ndarray:
        return self._in_drawer(HANDLE)

    @cached_property
    def _opening(self) -> float:
        return float((self.poses[4, :3] - self.poses[3, :3]) @ self._front - DRAWER_JOINT.origin[0])

    @cached_property
    def _at_bar(self) -> bool:
        offset = self._tool[:3] - self._bar
        return bool(np.hypot(*offset[:2]) < 2 * _NEAR and offset[2] < _CLEAR)

    @cached_property
    def _rim(self) -> np.ndarray:
        """Place (3,) on the mug's wall that the fingers close on, away from its handle."""
        turn = Rotation.from_quat(self.poses[5, 3:], scalar_first=True)
        handle = float(turn.apply([1.0, 0.0, 0.0]) @ self._side)
        to_tool = float((self._tool[:3] - self.poses[5, :3]) @ self._side)
        away = -handle if abs(handle) > 0.4 else to_tool  # either side will do where it points along the front
        out = np.copysign(self.mug.radius - 0.5 * self.mug.wall, away)
        return self.poses[5, :3] + out * self._side + (0.5 * self.mug.height - _BELOW_RIM) * _UP

    @cached_property
    def _height(self) -> float:
        """Of the mug's bottom over the tray's floor."""
        return float(self.poses[5, 2] - 0.5 * self.mug.height - self._in_drawer((0.0, 0.0, TRAY_FLOOR))[2])

    @cached_property
    def _inside(self) -> bool:
        """Whether the mug is in the tray."""
        local = self._drawer.inv().apply(self.poses[5, :3] - self.poses[4, :3])
        low, high = np.array(TRAY)
        return bool(((local[:2] > low) & (local[:2] < high)).all() and self._height < _IN_TRAY)
