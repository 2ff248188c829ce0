"""Putting a mug into a cabinet's drawer with the Panda: open, put in, shut. Each phase is told from the poses alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots import panda
from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.sim.mugs import Mug
from pwm_gym.skills.carry import Carry
from pwm_gym.skills.motion import servo
from pwm_gym.skills.mug_grips import MugGrip, body_grip, fits_body, rim_grip
from pwm_gym.skills.open_drawer import OpenDrawer
from pwm_gym.skills.push import Push

__all__ = ["CleanUp"]

_UP = np.array([0.0, 0.0, 1.0])
_SHUT = 0.005  # metres of the drawer's way
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
    by_body: bool = False
    """Whether the mug is held about its body, where the gripper is wide enough, instead of by its rim."""
    hooked: bool = False
    """Whether shut fingers pull the drawer open, instead of holding its handle between them."""

    def act(self) -> np.ndarray:
        """Action (7,)."""
        if self._inside:
            return self._shut()
        grip = self._grip
        if grip.pinch.holds(self.poses, grip.place):
            return self._carry()
        opening = self._drawer.act()
        return grip.pinch.act(self.poses, grip.place, grip.closing) if opening is None else opening

    # Phases -------------------------------------------------------------------------------------------------------

    def _carry(self) -> np.ndarray:
        """Bring the held mug over the drawer's edge into it."""
        place = self._drawer.in_drawer(LOW_CABINET.place) + 0.5 * self.mug.height * _UP
        return Carry(0.13, self.speed).act(self.poses, self.poses[5, :3], place, self._side)

    def _shut(self) -> np.ndarray:
        """Let the mug go, and push the drawer."""
        if self._drawer.opening < _SHUT:
            return self._stay(gripper=-1.0)
        grip, wide = self._grip, self._grip.pinch.opening
        if panda.opening(self.poses) < grip.released and np.linalg.norm(grip.place - self._tool[:3]) < _NEAR:
            if self._height > _ON_FLOOR:
                return self._carry()
            return self._stay(panda.gripper_command(wide))
        return Push(0.12, wide, self.speed).act(self.poses, self._drawer.bar, self._drawer.front)

    def _stay(self, gripper: float) -> np.ndarray:
        return servo(panda.PANDA, self._tool, self._tool[:3], self._side, self.speed, gripper)

    # What the poses tell ------------------------------------------------------------------------------------------

    @cached_property
    def _tool(self) -> np.ndarray:
        return panda.tool_pose(self.poses)

    @cached_property
    def _drawer(self) -> OpenDrawer:
        return OpenDrawer(self.poses, self.poses[3], self.poses[4], self.speed, self.hooked)

    @cached_property
    def _turn(self) -> Rotation:
        return Rotation.from_quat(self.poses[4, 3:], scalar_first=True)

    @cached_property
    def _side(self) -> np.ndarray:
        """Direction (3,) along the cabinet's front."""
        return self._turn.apply([0.0, 1.0, 0.0])

    @cached_property
    def _grip(self) -> MugGrip:
        """How the mug is held."""
        mug, pose = self.mug, self.poses[5]
        if self.by_body and fits_body(mug):
            return body_grip(mug, pose, self.speed)
        return rim_grip(mug, pose, self._side, self._tool, self.speed)

    @cached_property
    def _height(self) -> float:
        """Of the mug's bottom over the tray's floor."""
        floor = self._drawer.in_drawer((0.0, 0.0, LOW_CABINET.tray_floor))[2]
        return float(self.poses[5, 2] - 0.5 * self.mug.height - floor)

    @cached_property
    def _inside(self) -> bool:
        """Whether the mug is in the tray."""
        local = self._turn.inv().apply(self.poses[5, :3] - self.poses[4, :3])
        low, high = np.array(LOW_CABINET.tray)
        return bool(((local[:2] > low) & (local[:2] < high)).all() and self._height < _IN_TRAY)
