"""Making coffee ready with the Panda: the mug to the machine, the pod out of the drawer, then as :mod:`.brew` does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots import panda
from pwm_gym.sim.coffee_machine import HOLDER_FLOOR, MUG_AHEAD, POD_HEIGHT
from pwm_gym.sim.mugs import Mug
from pwm_gym.skills.brew import Brew
from pwm_gym.skills.carry import Carry
from pwm_gym.skills.motion import servo
from pwm_gym.skills.mug_grips import MugGrip, rim_grip
from pwm_gym.skills.open_drawer import OpenDrawer

__all__ = ["Prepare"]

_LINKS = [0, 1, 2]  # of the gripper
_MACHINE, _LID, _POD, _CABINET, _DRAWER, _MUG = range(3, 9)
_THERE = (0.014, 0.004)  # metres beside the mug's place and over the table: it stands there
_NEAR = 0.02  # from where it was held: the tool has not left it yet
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Prepare:
    """The next action for a scene of hand, left finger, right finger, machine, lid, pod, cabinet, drawer and mug."""

    poses: np.ndarray
    """(9, 7)."""
    mug: Mug
    speed: float
    """Longest translation asked for in a step, metres."""

    def act(self) -> np.ndarray:
        """Action (7,)."""
        if self._pod_out:
            return self._brew()
        if not self._mug_there:
            return self._bring_mug()
        grip = self._grip
        if panda.opening(self.poses) < grip.released and np.linalg.norm(grip.place - self._tool[:3]) < _NEAR:
            wide = panda.gripper_command(grip.pinch.opening)
            return servo(panda.PANDA, self._tool, self._tool[:3], self._side, self.speed, wide)
        opening = OpenDrawer(self.poses, self.poses[_CABINET], self.poses[_DRAWER], self.speed).act()
        return self._brew() if opening is None else opening

    def _bring_mug(self) -> np.ndarray:
        grip = self._grip
        if grip.pinch.holds(self.poses, grip.place):
            return Carry(0.03, self.speed).act(self.poses, self.poses[_MUG, :3], self._stand, self._side)
        return grip.pinch.act(self.poses, grip.place, grip.closing)

    def _brew(self) -> np.ndarray:
        return Brew(self.poses[[*_LINKS, _MACHINE, _LID, _POD]], self.speed).act()

    # What the poses tell ------------------------------------------------------------------------------------------

    @cached_property
    def _tool(self) -> np.ndarray:
        return panda.tool_pose(self.poses)

    @cached_property
    def _machine(self) -> Rotation:
        return Rotation.from_quat(self.poses[_MACHINE, 3:], scalar_first=True)

    @cached_property
    def _side(self) -> np.ndarray:
        return self._machine.apply([0.0, 1.0, 0.0])

    @cached_property
    def _stand(self) -> np.ndarray:
        """Where the mug's middle (3,) belongs."""
        foot = self.poses[_MACHINE, :3] + self._machine.apply([MUG_AHEAD, 0.0, 0.0])
        return foot + 0.5 * self.mug.height * _UP

    @cached_property
    def _grip(self) -> MugGrip:
        return rim_grip(self.mug, self.poses[_MUG], self._side, self._tool, self.speed)

    @cached_property
    def _mug_there(self) -> bool:
        offset = self.poses[_MUG, :3] - self._stand
        return bool(np.hypot(*offset[:2]) < _THERE[0] and abs(offset[2]) < _THERE[1])

    @cached_property
    def _pod_out(self) -> bool:
        """Whether the pod is over the drawer, or in the holder."""
        seat = self.poses[_MACHINE, :3] + (HOLDER_FLOOR + 0.5 * POD_HEIGHT) * _UP
        seated = np.linalg.norm(self.poses[_POD, :3] - seat) < 0.02
        return bool(seated or self.poses[_POD, 2] > self.poses[_CABINET, 2] + 0.02)
