"""Tapping a puck with shut fingers so that it slides to a place by itself. Metres, base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwm_gym.robots import Robot
from pwm_gym.skills.motion import drive, tool_pose

__all__ = ["TableTap"]

_GAIN = 1.5  # of the hand's controller, which makes six tenths of what it is asked for
_TOUCHING = 0.002  # beside the place where a tap begins, within which it does
_LEVEL = 0.006  # over or under its height, within which it does
_ABOVE = 0.004  # beside that place, within which the tool comes down
_LEFT = 0.015  # further from the puck than where a tap begins, from where it has been tapped
_CREEP = 0.003  # asked for in a step behind a puck that slides
_FULL = 0.97  # share of the longest slide up to which one tap is enough
_SHARE = 0.93  # share of it that a first tap leaves of a longer way
_FADES, _WEAKEST = 3.2, 0.5  # how much weaker strokes become a metre beyond the reach, and at the least
_LEAST = 0.04  # metres that a first tap sends a puck


@dataclass(frozen=True)
class TableTap:
    """Over the puck to its far side from the target, down beside it, and one stroke; then leave it alone.

    A tap that begins at rest beside the puck makes it slide by the square of its strength. Fingers are a box, so that
    a puck leaves in another direction than the stroke's, and some strokes send it further.
    """

    robot: Robot
    entity: int
    """Puck's place among the entities."""
    radius: float
    """Of the puck."""
    half: tuple[float, float]
    """Half the sides of the shut fingers along the base's x and y axes."""
    stroke: float
    """Translation asked for in the strongest tap."""
    strokes: tuple[float, ...]
    """Directions, degrees from the x axis towards the y axis, of strokes that were measured."""
    launches: tuple[float, ...]
    """Directions in which they send the puck."""
    slides: tuple[float, ...]
    """How far the strongest ones send it."""
    reach: float
    """Distance from the base up to which strokes are as strong."""
    height: float = 0.03
    """Of the tool where it taps."""
    tapped_above: float = 0.025
    """Height of a low tool that has tapped the puck already; episodes begin with a lower one."""
    clearance: float = 0.07
    """Height of the tool at which it passes over the puck."""
    gap: float = 0.0025
    """Between fingers and puck where a tap begins."""

    def act(self, poses: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Action (A,) that sends the puck to a place (3,), for poses (E, 7)."""
        tool, puck = tool_pose(self.robot, poses)[:3], poses[self.entity, :3]
        way = target[:2] - puck[:2]
        distance = float(np.linalg.norm(way))
        ahead, slide = self._stroke(way)
        slide *= float(np.clip(1.0 - _FADES * (np.linalg.norm(puck[:2]) - self.reach), _WEAKEST, 1.0))
        contact = self._contact(ahead) + self.gap
        place = np.array([*(puck[:2] - contact * ahead), self.height])
        offset = place - tool
        if (
            np.linalg.norm(offset[:2]) < _TOUCHING + self.gap
            and abs(offset[2]) < _LEVEL
            and self._aligned(offset, ahead)
        ):
            return self._drive(np.r_[self.stroke * self._strength(distance, slide, puck) * ahead, offset[2]])
        low = abs(offset[2]) < _LEVEL and tool[2] > self.tapped_above
        if low and np.linalg.norm(tool[:2] - puck[:2]) > contact + _LEFT:
            step = self.stroke if distance > _SHARE * slide else _CREEP  # another tap is needed, or maybe
            return self._drive(offset * min(1.0, step / float(np.linalg.norm(offset))))
        return self._come(offset, tool)

    def _strength(self, distance: float, slide: float, puck: np.ndarray) -> float:
        """Share of the strongest stroke for a way; one that is too long for a single tap is shortened first.

        A first tap does not send the puck out of reach, where strokes lose more than the way gets shorter.
        """
        room = self.reach - float(np.linalg.norm(puck[:2]))
        if distance > _FULL * slide and room > _LEAST:
            distance = min(max(distance - _SHARE * slide, _LEAST), room)
        return min(float(np.sqrt(distance / slide)), 1.0)

    def _aligned(self, offset: np.ndarray, ahead: np.ndarray) -> bool:
        """Whether the tool is on the line of the stroke."""
        return bool(abs(ahead[0] * offset[1] - ahead[1] * offset[0]) < _TOUCHING)

    def _come(self, offset: np.ndarray, tool: np.ndarray) -> np.ndarray:
        """Up, over the place where the tap begins, and down."""
        step = offset.copy()
        beside = float(np.linalg.norm(offset[:2]))
        if beside > _ABOVE:
            step[2] = self.clearance - tool[2]
            if tool[2] < self.height + _LEVEL:  # not yet out of the puck's way
                step[:2] = 0.0
        return self._drive(_GAIN * step)

    def _drive(self, offset: np.ndarray) -> np.ndarray:
        return drive(self.robot, offset, self.stroke, gripper=-1.0)

    def _stroke(self, way: np.ndarray) -> tuple[np.ndarray, float]:
        """Direction (2,) of the stroke that sends the puck a way (2,), and how far the strongest one sends it."""
        launch = np.degrees(np.arctan2(*np.abs(way[::-1])))
        angle = float(np.interp(launch, self.launches, self.strokes))
        signs = np.where(way < 0.0, -1.0, 1.0)
        direction = signs * [np.cos(np.radians(angle)), np.sin(np.radians(angle))]
        return direction, float(np.interp(angle, self.strokes, self.slides))

    def _contact(self, ahead: np.ndarray) -> float:
        """Distance from the tool to the puck's centre where shut fingers touch it."""
        x, y = np.abs(ahead)
        half = np.array(self.half)
        if y * (half[0] + self.radius) <= half[1] * x:
            return float((half[0] + self.radius) / x)
        if x * (half[1] + self.radius) <= half[0] * y:
            return float((half[1] + self.radius) / y)
        corner = float(half @ [x, y])
        return float(corner + np.sqrt(corner**2 - half @ half + self.radius**2))
