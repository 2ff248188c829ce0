"""Pulling a cabinet's drawer open by its handle with the Panda: phases are told from the poses alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots import panda
from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.skills.motion import servo
from pwm_gym.skills.pinch import Pinch

__all__ = ["OpenDrawer"]

_UP = np.array([0.0, 0.0, 1.0])
_PULLED, _OPEN = 0.15, 0.135  # metres of the drawer's way
_WIDE, _RELEASED = 0.032, 0.026  # between the pads on the way down, and when they have left the bar
_NEAR, _CLEAR = 0.04, 0.05  # beside and over the handle, within which the tool has not left it yet
_OVER_BAR = 0.08  # of shut fingers over the handle, on their way behind it
_AMID, _LOW = 0.012, 0.008  # beside their place behind it, where they come down, and over it, where they pull
_HANGS = 0.030  # beside that place, of fingers that pull


@dataclass(frozen=True)
class OpenDrawer:
    """The next action towards an open drawer whose handle has been left."""

    poses: np.ndarray
    """Scene poses (E, 7), the gripper's three links first."""
    cabinet: np.ndarray
    """Pose (7,)."""
    drawer: np.ndarray
    """Pose (7,)."""
    speed: float
    """Longest translation asked for in a step, metres."""
    hooked: bool = False
    """Whether shut fingers pull the handle from behind, instead of holding it between them."""

    def act(self) -> np.ndarray | None:
        """Action (7,); None where nothing is left to do."""
        pulling = self._hook() if self.hooked else self._pull()
        if pulling is not None:
            return pulling
        return self._leave() if self._at_bar else None

    def _pull(self) -> np.ndarray | None:
        """Hold the handle from above, and away with it; None where the drawer is open."""
        bar = Pinch((LOW_CABINET.handle_width - 0.004, LOW_CABINET.handle_width + 0.004), _WIDE, 0.08, self.speed)
        if bar.holds(self.poses, self.bar) and self.opening < _PULLED:
            return self._move(self.bar + 0.05 * self.front, gripper=-1.0)
        if self.opening < _OPEN:
            return bar.act(self.poses, self.bar, self.front)
        return None

    def _hook(self) -> np.ndarray | None:
        """Shut fingers over the gap behind the handle, down, and away with it; None where the drawer is open."""
        place = self.in_drawer((LOW_CABINET.gap_middle, *LOW_CABINET.handle[1:]))
        offset = self._tool[:3] - place
        beside = float(np.hypot(*offset[:2]))
        if beside < _HANGS and offset[2] < _LOW and self.opening < _PULLED:
            return self._move(self._tool[:3] + 0.05 * self.front, gripper=-1.0)
        if self.opening >= _OPEN:
            return None
        target = place + _OVER_BAR * _UP
        if beside < _AMID:
            target = place
        elif offset[2] < _OVER_BAR - 0.03:  # rise before moving sideways
            target[:2] = self._tool[:2]
        return self._move(target, gripper=-1.0)

    def _leave(self) -> np.ndarray:
        """Let the handle go, then rise straight."""
        if self.hooked:
            return self._move(self._tool[:3] + 0.1 * _UP, gripper=-1.0)
        wide = panda.gripper_command(_WIDE)
        if panda.opening(self.poses) < _RELEASED:
            return self._move(self._tool[:3], wide)
        return self._move(self._tool[:3] + 0.1 * _UP, wide)

    def _move(self, target: np.ndarray, gripper: float) -> np.ndarray:
        return servo(panda.PANDA, self._tool, target, self._closing, self.speed, gripper)

    # What the poses tell ------------------------------------------------------------------------------------------

    @cached_property
    def _tool(self) -> np.ndarray:
        return panda.tool_pose(self.poses)

    @cached_property
    def _turn(self) -> Rotation:
        return Rotation.from_quat(self.drawer[3:], scalar_first=True)

    @cached_property
    def front(self) -> np.ndarray:
        """Direction (3,) in which the drawer opens."""
        return self._turn.apply([1.0, 0.0, 0.0])

    @cached_property
    def _closing(self) -> np.ndarray:
        """Direction (3,) along which the fingers close: across the handle's bar, or, where it is hooked, along it."""
        return np.cross(_UP, self.front) if self.hooked else self.front

    @cached_property
    def bar(self) -> np.ndarray:
        """Middle (3,) of the handle's bar."""
        return self.in_drawer(LOW_CABINET.handle)

    @cached_property
    def opening(self) -> float:
        """How far it is open."""
        return float((self.drawer[:3] - self.cabinet[:3]) @ self.front - LOW_CABINET.joint.origin[0])

    @cached_property
    def _at_bar(self) -> bool:
        offset = self._tool[:3] - self.bar
        return bool(np.hypot(*offset[:2]) < _NEAR and offset[2] < _CLEAR)

    def in_drawer(self, point: tuple[float, float, float]) -> np.ndarray:
        """Place (3,) of a point of the drawer's frame."""
        return self.drawer[:3] + self._turn.apply(point)
