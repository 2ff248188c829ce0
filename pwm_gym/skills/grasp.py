"""Grasps from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Robot
from pwm_gym.skills.motion import drive, tool_pose, yaw_error

__all__ = ["TopGrasp"]

_ALIGNED = 0.12  # radians by which the fingers may be turned against the object's sides
_OVER = 0.012  # metres beside the object within which the tool descends
_CENTRED = (0.006, 0.008)  # metres beside and above the object's centre within which the fingers shut
_RISE_FIRST = 0.02  # metres below the hover height, and beside the object, from which the tool rises before it moves
_HELD = (0.006, 0.018)  # metres: opening against the object's width, and tool from its centre
_FINGER = 0.053  # metres from the tool to the middle of an open finger
_CLEAR = 0.045  # metres between a finger's middle and another object's centre that leave room for both


@dataclass(frozen=True)
class TopGrasp:
    """Hover over an object, turn the fingers along its sides, descend and shut."""

    robot: Robot
    entity: int
    """Object's place among the entities."""
    width: float
    """Object's width between the fingers, metres."""
    speed: float
    """Longest translation asked of the controller in one step, metres; it lags and makes about half of it."""
    hover: float = 0.08
    """Height of the tool over the object before it descends, metres."""
    obstacles: tuple[int, ...] = ()
    """Objects that the open fingers must not come down on, as places among the entities."""

    def holds(self, poses: np.ndarray) -> bool:
        """Whether the fingers were stopped by the object, for poses (E, 7)."""
        if self.robot.opening is None:
            raise PwmGymError(f"robot {self.robot.name!r} has no gripper's opening; a grasp needs it")
        stopped = abs(self.robot.opening(poses) - self.width) < _HELD[0]
        return bool(stopped and np.linalg.norm(self._reach(poses)) < _HELD[1])

    def act(self, poses: np.ndarray) -> np.ndarray:
        """Action (A,) towards a grasp, for poses (E, 7)."""
        reach = self._reach(poses)
        turn = self._turn(poses)
        aligned = abs(turn) < _ALIGNED
        beside = np.linalg.norm(reach[:2])
        if aligned and beside < _CENTRED[0] and abs(reach[2]) < _CENTRED[1]:
            return drive(self.robot, reach, self.speed, gripper=-1.0, turn=turn)
        if aligned and beside < _OVER:
            return drive(self.robot, reach, self.speed, gripper=1.0, turn=turn)
        above = reach + [0.0, 0.0, self.hover]
        if above[2] > _RISE_FIRST and beside > _RISE_FIRST:
            above[:2] = 0.0
        return drive(self.robot, above, self.speed, gripper=1.0, turn=turn)

    def _reach(self, poses: np.ndarray) -> np.ndarray:
        return poses[self.entity, :3] - tool_pose(self.robot, poses)[:3]

    def _turn(self, poses: np.ndarray) -> float:
        """Smallest turn that aligns the fingers, or the one a quarter further if only that one leaves them room.

        None for a robot that cannot turn its hand: it takes the object as it lies.
        """
        if not self.robot.control.of_kind("rotation", "yaw"):
            return 0.0
        tool = tool_pose(self.robot, poses)
        turn = yaw_error(tool, poses[self.entity])
        if not self.obstacles:
            return turn
        other = turn - np.copysign(np.pi / 2, turn)
        room = self._room(poses, tool, turn)
        return float(turn if room >= min(_CLEAR, self._room(poses, tool, other)) else other)

    def _room(self, poses: np.ndarray, tool: np.ndarray, turn: float) -> float:
        """Distance in the plane from the open fingers, once turned, to the nearest obstacle's centre."""
        y_tool = Rotation.from_quat(tool[3:], scalar_first=True).apply([0.0, 1.0, 0.0])
        axis = Rotation.from_rotvec([0.0, 0.0, turn]).apply(y_tool)[:2]
        fingers = poses[self.entity, :2] + _FINGER * np.stack([axis, -axis])
        gaps = poses[list(self.obstacles), None, :2] - fingers
        return float(np.linalg.norm(gaps, axis=-1).min())
