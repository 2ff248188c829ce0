"""Pushing an object over a table with shut fingers that point down. Metres, base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwm_gym.robots import Robot
from pwm_gym.skills.motion import drive, tool_pose

__all__ = ["TablePush"]

_BESIDE = 0.012  # of the line through the object, within which the tool comes down and begins to push
_LOST = 0.018  # of the line, from where a push that has begun is given up
_LEVEL = 0.012  # over its height, from where the tool pushes
_RISE = 0.02  # below the clearance, from where it rises before it moves sideways
_AHEAD = 0.05  # beyond the contact, where it is told to go
_GAIN = 1.5  # of the way back to the line


@dataclass(frozen=True)
class TablePush:
    """Over the object to its far side from the target, down, and push; over it again when it drifts off the line."""

    robot: Robot
    entity: int
    """Object's place among the entities."""
    contact: float
    """Distance from the tool to the object's centre where they touch."""
    height: float
    """Of the tool where it pushes."""
    clearance: float
    """Height of the tool at which it passes over the object."""
    speed: float
    """Longest translation asked for in a step."""
    gap: float = 0.03
    """Further distance from the object at which the tool comes down."""

    def act(self, poses: np.ndarray, target: np.ndarray, speed: float | None = None) -> np.ndarray:
        """Action (A,) that pushes the object towards a place.

        Args:
            poses: (E, 7).
            target: the place (3,).
            speed: longest translation of the push itself, where it is another one.
        """
        tool, body = tool_pose(self.robot, poses)[:3], poses[self.entity, :3]
        way = target[:2] - body[:2]
        distance = float(np.linalg.norm(way))
        ahead = way / max(distance, 1e-9)
        offset = tool[:2] - body[:2]
        behind, beside = -float(offset @ ahead), offset - (offset @ ahead) * ahead
        low, aside = tool[2] - self.height < _LEVEL, float(np.linalg.norm(beside))
        if low and behind > 0.5 * self.contact and aside < (_LOST if behind < self.contact + 0.01 else _BESIDE):
            return self._push(tool, ahead, beside, behind, distance, speed)
        start = np.array([*(body[:2] - (self.contact + self.gap) * ahead), self.height])
        return self._come(tool, start, float(np.linalg.norm(offset)))

    def _push(
        self,
        tool: np.ndarray,
        ahead: np.ndarray,
        beside: np.ndarray,
        behind: float,
        distance: float,
        speed: float | None,
    ) -> np.ndarray:
        """Forward as far as the object has to go, and back to the line."""
        left = behind - self.contact + distance
        step = np.array([*(left * ahead - _GAIN * beside), self.height - tool[2]])
        return drive(self.robot, step, self.speed if speed is None else speed, gripper=-1.0)

    def _come(self, tool: np.ndarray, start: np.ndarray, distance: float) -> np.ndarray:
        """Up, over the place where the push begins, and down."""
        offset = start - tool
        if np.linalg.norm(offset[:2]) > _BESIDE:
            offset[2] = self.clearance - tool[2]
            near = distance < self.contact + self.gap + 0.02
            if offset[2] > _RISE and near:
                offset[:2] = 0.0
        return drive(self.robot, offset, self.speed, gripper=-1.0)
