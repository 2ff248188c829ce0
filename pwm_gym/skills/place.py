"""Putting a held object down on a place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Robot
from pwm_gym.skills.motion import drive, tool_pose

__all__ = ["Place"]

_OVER = 0.006  # metres beside the place within which the object is lowered
_NEAR = 0.06  # metres beside the place within which the object must be above the clearance
_PLACED = (0.015, 0.004)  # metres beside and above the place
_OPEN = 0.015  # metres by which the fingers are wider than the object before they leave it


@dataclass(frozen=True)
class Place:
    """Lift, carry over the place, lower, release, retreat."""

    robot: Robot
    entity: int
    """Object's place among the entities."""
    width: float
    """Object's width between the fingers, metres."""
    speed: float
    """Longest translation asked of the controller in one step, metres."""
    clearance: float = 0.03
    """Height over the place at which the object is carried, metres."""
    retreat: float = 0.08
    """Height of the tool over the released object where it waits, metres."""

    def placed(self, poses: np.ndarray, target: np.ndarray) -> bool:
        """Whether the object is at its place ``target`` (3,), for poses (E, 7)."""
        offset = target - poses[self.entity, :3]
        return bool(np.linalg.norm(offset[:2]) < _PLACED[0] and abs(offset[2]) < _PLACED[1])

    def carry(self, poses: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Action (A,) that brings the held object to ``target`` (3,) from above."""
        offset = target - poses[self.entity, :3]
        beside = np.linalg.norm(offset[:2])
        if beside > _OVER:
            offset = offset + [0.0, 0.0, self.clearance]
            if beside < _NEAR and offset[2] > 0.3 * self.clearance:  # too low to move sideways
                offset[:2] = 0.0
        return drive(self.robot, offset, self.speed, gripper=-1.0)

    def release(self, poses: np.ndarray) -> np.ndarray:
        """Action (A,) that opens the fingers and then takes them up, away from the object."""
        if self.robot.opening is None:
            raise PwmGymError(f"robot {self.robot.name!r} has no gripper's opening; a release needs it")
        if self.robot.opening(poses) < self.width + _OPEN:
            return drive(self.robot, np.zeros(3), self.speed, gripper=1.0)
        height = tool_pose(self.robot, poses)[2] - poses[self.entity, 2]
        return drive(self.robot, np.array([0.0, 0.0, max(self.retreat - height, 0.0)]), self.speed, gripper=1.0)
