"""Filling a drawer with two hands: the left one opens and shuts it, the right one brings a mug. Metres, base frame.

Each phase is told from the poses alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots import two_hands
from pwm_gym.robots.two_hands import FACE, SIGN, TOOL, TWO_HANDS, boxes
from pwm_gym.scene.poses import rotation
from pwm_gym.sim.cabinets import DEEP_CABINET
from pwm_gym.sim.mugs import TALL_MUG
from pwm_gym.skills.two_hands import FLAT, Reach, act, upright

__all__ = ["FillDrawer"]

_UP = np.array([0.0, 0.0, 1.0])
_WIDE = two_hands.finger_targets((0.5 * np.pi, 0.0), 0.0)
_CLOSED = np.array(two_hands.HOLDING)
_BAR_OVER = 0.006  # of the tool over the bar's middle, when the hand hangs behind it
_IN_GAP = DEEP_CABINET.gap_middle  # x of the tool there, in the drawer's frame
_OVER_BAR = 0.10  # of the tool over that height, on its way there
_TURNED = 0.15  # radians by which a hand may be turned when it comes down
_AMID = (0.018, 0.026)  # across and along the drawer's way, beside the gap's middle, of a hand that comes down
_HANGS = 0.05  # over its height, of a hand that is in the gap
_PULL, _FURTHER = 0.035, 0.012  # asked for in a step, and how much farther than counts as open it is pulled
_PUSH, _SHUT = 0.035, 0.004
_FROM_MUG = FACE + TALL_MUG.radius + 0.008  # of the tool from the mug's axis, out of the palm, before it closes
_GRIP_HEIGHT = 0.018  # of the tool over the mug's middle
_TRAVEL = 0.12  # of the tool over that height, on its way
_THERE = (0.009, 0.010)  # beside and over its place, from where the hand closes
_HOLDS = (0.008, 0.006)  # gaps to the mug of fingers and thumb that hold it
_CARRY = 0.13  # of the mug's bottom over the tray's floor, at which it is carried
_OVER_PLACE, _ASTRAY = 0.012, 0.030  # beside its place: the mug is lowered; it is lifted again first
_ON_FLOOR, _IN_TRAY = 0.009, 0.014  # a mug that leans a little comes no lower than 7 mm
_OPEN = 0.06  # radians of the thumb that has let the mug go
_CLEAR = 0.13  # of the tool over the mug's middle, when the drawer may be shut


@dataclass(frozen=True)
class FillDrawer:
    """The next action for a scene of both hands' links, then cabinet, drawer and mug."""

    poses: np.ndarray
    """(25, 7)."""
    speed: float
    """Longest translation asked for in a step."""

    def act(self) -> np.ndarray:
        """Action (24,)."""
        return act(self.poses, {"left": self._left(), "right": self._right()})

    # The left hand ------------------------------------------------------------------------------------------------

    def _left(self) -> Reach:
        """Into the gap behind the bar from above; pull, hang there, push."""
        hang = self._in_drawer((_IN_GAP, DEEP_CABINET.handle[1], DEEP_CABINET.handle[2] + _BAR_OVER))
        if not self._hangs:
            return self._hook(hang)
        if self._inside and self._clear:
            far = 0.0 if self.opening < _SHUT else _PUSH
            return self._left_reach(hang, -far * self._front)
        if self.opening < DEEP_CABINET.opened + _FURTHER and not self._inside:
            return self._left_reach(hang, _PULL * self._front)
        return self._left_reach(hang)

    def _hook(self, hang: np.ndarray) -> Reach:
        offset = self._left_tool[:3] - hang
        along, across = offset @ self._front, offset @ np.cross(_UP, self._front)
        amid = abs(along) < _AMID[0] and abs(across) < _AMID[1]
        turned = np.linalg.norm(upright(self._left_tool, self._front)) < _TURNED
        high = _OVER_BAR * _UP
        if not (amid and turned):
            low = offset[2] < _OVER_BAR - 0.03
            return self._left_reach(np.r_[self._left_tool[:2], hang[2] + _OVER_BAR] if low else hang + high)
        return self._left_reach(hang)

    def _left_reach(self, target: np.ndarray, push: np.ndarray | None = None) -> Reach:
        """Where the left hand goes, or, with a push, goes on along the drawer's way."""
        if push is not None and push.any():
            offset = target - self._left_tool[:3]
            target = target - (offset @ self._front) * self._front
        return Reach(target, self._front, self.speed, FLAT, push)

    # The right hand -----------------------------------------------------------------------------------------------

    def _right(self) -> Reach:
        """Over the mug, down, close; over the tray, down, open, up."""
        place, offset = self._grip, self._right_tool[:3] - self._grip
        if self._inside and self._height < _ON_FLOOR:
            return self._let_go(offset)
        if self._held:
            return self._carry()
        beside = float(np.hypot(*offset[:2]))
        if beside < _THERE[0] and abs(offset[2]) < _THERE[1]:
            return self._right_reach(self._right_tool[:3] + 0.5 * (place - self._right_tool[:3]), _CLOSED)
        if beside > 0.02 or offset[2] < -_THERE[1]:
            place = place + _TRAVEL * _UP
            if offset[2] < _TRAVEL - 0.04 and beside > 0.02:
                place = np.r_[self._right_tool[:2], place[2]]
        elif self.opening < DEEP_CABINET.opened and offset[2] > 0.06:  # it waits above for the drawer
            place = place + 0.08 * _UP
        return self._right_reach(place, _WIDE)

    def _carry(self) -> Reach:
        """Lift, carry over the tray, lower; wait where the drawer is not open."""
        way = self._place - self.poses[-1, :3]
        beside, height = float(np.hypot(*way[:2])), -float(way[2])
        if beside > _ASTRAY or self.opening < DEEP_CABINET.opened:
            way[2] = _CARRY - height
            if way[2] > 0.03 or self.opening < DEEP_CABINET.opened:
                way[:2] = 0.0
        elif beside > _OVER_PLACE:
            way[2] = min(_CARRY - height, 0.0)
        sideways = min(1.0, self.speed / max(beside, 1e-9))
        step = np.r_[sideways * way[:2], np.clip(way[2], -0.7 * self.speed, self.speed)]
        return self._right_reach(self._right_tool[:3] + step, _CLOSED)

    def _let_go(self, offset: np.ndarray) -> Reach:
        """Open; up, once the thumb has left the mug."""
        if self._thumb_angle > _OPEN and offset[2] < 0.03:
            return self._right_reach(self._right_tool[:3], _WIDE)
        if offset[2] < 0.03 and np.hypot(*offset[:2]) > 0.006:
            return self._right_reach(self._grip, _WIDE)
        high = min(self._grip[2] + _CLEAR + 0.05, self._right_tool[2] + 0.1)
        return self._right_reach(np.r_[self._right_tool[:2], high], _WIDE)

    def _right_reach(self, target: np.ndarray, fingers: np.ndarray) -> Reach:
        return Reach(target, self._facing, self.speed, fingers)

    # What the poses tell ------------------------------------------------------------------------------------------

    @cached_property
    def opening(self) -> float:
        """Of the drawer."""
        return float((self.poses[-2, :3] - self.poses[-3, :3]) @ self._front)

    @cached_property
    def _drawer(self) -> Rotation:
        return rotation(self.poses[-2])

    @cached_property
    def _front(self) -> np.ndarray:
        """Direction (3,) in which it opens."""
        return self._drawer.apply([1.0, 0.0, 0.0])

    def _in_drawer(self, point: tuple[float, float, float]) -> np.ndarray:
        return self.poses[-2, :3] + self._drawer.apply(point)

    @cached_property
    def _left_tool(self) -> np.ndarray:
        return two_hands.tool_pose(self.poses, "left")

    @cached_property
    def _right_tool(self) -> np.ndarray:
        return two_hands.tool_pose(self.poses, "right")

    @cached_property
    def _hangs(self) -> bool:
        """Whether the left hand is in the gap."""
        x, y, z = self._drawer.inv().apply(self._left_tool[:3] - self.poses[-2, :3])
        inside = DEEP_CABINET.front < x < DEEP_CABINET.handle[0] and abs(y - DEEP_CABINET.handle[1]) < 0.04
        return bool(inside and z - DEEP_CABINET.handle[2] - _BAR_OVER < _HANGS and self._turned_left)

    @cached_property
    def _turned_left(self) -> bool:
        return bool(np.linalg.norm(upright(self._left_tool, self._front)) < 2 * _TURNED)

    @cached_property
    def _facing(self) -> np.ndarray:
        """Direction (3,) that the right palm faces: across the drawer, to the left hand."""
        return np.cross(self._front, _UP)

    @cached_property
    def _grip(self) -> np.ndarray:
        """Where (3,) the right tool is before it closes about the mug."""
        return self.poses[-1, :3] - _FROM_MUG * self._facing + _GRIP_HEIGHT * _UP

    @cached_property
    def _thumb_angle(self) -> float:
        """Of the right thumb's second joint."""
        first, second = (rotation(self.poses[TWO_HANDS.driven.index(f"right_thumb_{k}")]) for k in (1, 2))
        return float((first.inv() * second).as_rotvec() @ TWO_HANDS.joints["right_thumb_2"].axis)

    @cached_property
    def _held(self) -> bool:
        """Whether fingers and thumb touch the mug between them."""
        palm = self.poses[TWO_HANDS.driven.index("right_palm")]
        thumb = self.poses[TWO_HANDS.driven.index("right_thumb_2")]
        x, y, z = rotation(palm).inv().apply(self.poses[-1, :3] - palm[:3]) - np.array(TOOL)
        (_, thick, length), _ = boxes("right_thumb_2")[0]
        inner = thumb[:3] + rotation(thumb).apply([[0.0, -0.5 * SIGN["right"] * thick, h * length] for h in (0.3, 1.0)])
        ahead = float((rotation(palm).inv().apply(inner - palm[:3])[:, 0] - TOOL[0]).min())
        touching = x - TALL_MUG.radius - FACE < _HOLDS[0] and ahead - x - TALL_MUG.radius < _HOLDS[1]
        return bool(touching and abs(y) < 0.03 and abs(z) < 0.05)

    @cached_property
    def _place(self) -> np.ndarray:
        """Where the mug's middle (3,) belongs."""
        return self._in_drawer(DEEP_CABINET.place) + 0.5 * TALL_MUG.height * _UP

    @cached_property
    def _height(self) -> float:
        """Of the mug's bottom over the tray's floor."""
        floor = self._in_drawer((0.0, 0.0, DEEP_CABINET.tray_floor))[2]
        return float(self.poses[-1, 2] - 0.5 * TALL_MUG.height - floor)

    @cached_property
    def _inside(self) -> bool:
        """Whether the mug is in the tray."""
        local = self._drawer.inv().apply(self.poses[-1, :3] - self.poses[-2, :3])
        low, high = np.array(DEEP_CABINET.tray)
        return bool(((local[:2] > low) & (local[:2] < high)).all() and self._height < _IN_TRAY)

    @cached_property
    def _clear(self) -> bool:
        """Whether the right hand has left the mug."""
        return bool(self._right_tool[2] - self.poses[-1, 2] > _CLEAR)
