"""Putting a pod into a coffee machine with the Panda, and shutting the lid: phases are told from the poses alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots import panda
from pwm_gym.sim.coffee_machine import HOLDER_FLOOR, LID_JOINT, LID_LENGTH, POD_HEIGHT, POD_RADIUS, RIM
from pwm_gym.skills.carry import Carry
from pwm_gym.skills.motion import servo
from pwm_gym.skills.pinch import Pinch

__all__ = ["Brew"]

_UP = np.array([0.0, 0.0, 1.0])
_BELOW_TOP = 0.009  # metres: where the pod is held
_WIDE = 0.068  # metres between the pads on the way down
_RELEASED = 0.056  # metres between the pads when they have left the pod
_INTO = 0.007  # metres below the rim, where the pod is let go
_SEATED = (0.008, 0.016)  # metres beside the holder's axis and over its floor: it counts as put in
_DROP = (0.003, 0.003)  # metres beside and above the place from where it is dropped
_BEHIND, _HIGH = 0.062, 0.06  # metres behind and above the hinge, from where the lid is pushed
_OVER = 0.150  # metres above the hinge, where the tool passes over the open lid
_FALLS = np.radians(75.0)  # below this the lid falls shut by itself
_SHUT = np.radians(3.0)
_PRESS = 0.03  # metres before the lid's end, where it is pressed


@dataclass(frozen=True)
class Brew:
    """The next action for a scene of hand, left finger, right finger, machine, lid and pod."""

    poses: np.ndarray
    """(6, 7)."""
    speed: float
    """Longest translation asked for in a step, metres."""

    def act(self) -> np.ndarray:
        """Action (7,)."""
        pinch = Pinch((2 * POD_RADIUS - 0.010, 2 * POD_RADIUS + 0.003), _WIDE, 0.08, self.speed)
        if self._seated:
            return self._shut()
        if pinch.holds(self.poses, self._top):
            return self._insert()
        return pinch.act(self.poses, self._top, self._side)

    def _insert(self) -> np.ndarray:
        """Bring the held pod over the holder, into its funnel, and let it go."""
        place = self._in_machine((0.0, 0.0, RIM - _INTO + 0.5 * POD_HEIGHT))
        offset = self.poses[5, :3] - place
        if np.hypot(*offset[:2]) < _DROP[0] and offset[2] < _DROP[1]:
            return self._move(self._tool[:3], panda.gripper_command(_WIDE))
        return Carry(0.05, self.speed, beside=0.002).act(self.poses, self.poses[5, :3], place, self._side)

    def _shut(self) -> np.ndarray:
        """Let the pod go, go behind the lid, push it over, press it."""
        if panda.opening(self.poses) < _RELEASED and np.linalg.norm(self._top - self._tool[:3]) < 0.03:
            return self._move(self._tool[:3], panda.gripper_command(_WIDE))
        if self._angle < _SHUT:
            return self._move(self._tool[:3], -1.0)
        if self._angle < _FALLS:
            return self._reach(np.array([LID_LENGTH - _PRESS, 0.0, -0.01]), _OVER - 0.05, 0.025)
        x, y, z = self._from_hinge
        if x < 0.03 and abs(y) < 0.03 and z < _HIGH + 0.012 and x > -_BEHIND - 0.03:
            return self._move(self._hinge_point((0.06, 0.0, _HIGH)), -1.0)
        return self._reach(np.array([-_BEHIND, 0.0, _HIGH]), _OVER, 0.02)

    def _reach(self, target: np.ndarray, over: float, aside: float) -> np.ndarray:
        """Rise to ``over``, move sideways, then go down to ``target``: both from the hinge."""
        here = self._from_hinge
        if np.hypot(*(target - here)[:2]) > aside:
            target = np.array([*(here[:2] if here[2] < over - 0.02 else target[:2]), over])
        low = self._near_pod and here[2] < over - 0.05
        return self._move(self._hinge_point(target), panda.gripper_command(_WIDE) if low else -1.0)

    def _move(self, target: np.ndarray, gripper: float) -> np.ndarray:
        return servo(panda.PANDA, self._tool, target, self._side, self.speed, gripper)

    # What the poses tell ------------------------------------------------------------------------------------------

    @cached_property
    def _tool(self) -> np.ndarray:
        return panda.tool_pose(self.poses)

    @cached_property
    def _machine(self) -> Rotation:
        return Rotation.from_quat(self.poses[3, 3:], scalar_first=True)

    @cached_property
    def _side(self) -> np.ndarray:
        """Direction (3,) of the hinge."""
        return self._machine.apply([0.0, 1.0, 0.0])

    def _in_machine(self, point: tuple[float, float, float]) -> np.ndarray:
        return self.poses[3, :3] + self._machine.apply(point)

    def _hinge_point(self, point: np.ndarray | tuple[float, float, float]) -> np.ndarray:
        """Place (3,) of a point from the hinge, x to the machine's front."""
        return self.poses[4, :3] + self._machine.apply(point)

    @cached_property
    def _from_hinge(self) -> np.ndarray:
        """Tool (3,) from the hinge."""
        return self._machine.inv().apply(self._tool[:3] - self.poses[4, :3])

    @cached_property
    def _angle(self) -> float:
        """Of the lid."""
        lid = Rotation.from_quat(self.poses[4, 3:], scalar_first=True)
        return float((self._machine.inv() * lid).as_rotvec() @ LID_JOINT.axis)

    @cached_property
    def _top(self) -> np.ndarray:
        """Place (3,) where the pod is held."""
        return self.poses[5, :3] + (0.5 * POD_HEIGHT - _BELOW_TOP) * _UP

    @cached_property
    def _near_pod(self) -> bool:
        return bool(np.hypot(*(self._top - self._tool[:3])[:2]) < 0.03)

    @cached_property
    def _seated(self) -> bool:
        offset = self.poses[5, :3] - self._in_machine((0.0, 0.0, HOLDER_FLOOR + 0.5 * POD_HEIGHT))
        return bool(np.hypot(*offset[:2]) < _SEATED[0] and offset[2] < _SEATED[1])
