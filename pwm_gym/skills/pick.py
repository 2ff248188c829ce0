"""Picking up an object whose grasps are known, with the Panda: each phase is told from the poses alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots import panda
from pwm_gym.robots.gripper import PANDA
from pwm_gym.skills.motion import downward_turn, servo
from pwm_gym.skills.object_grasps import Grasp, ObjectGrasps

__all__ = ["PickObject"]

_CLEAR = 0.02  # metres between the finger tips and the object's top before the hand moves sideways
_NEAR_GOAL = 0.013  # metres, within which a heavy object is brought to rest slowly
_SLOW = 0.3  # of the gain there
_TOUCHING = 0.002  # metres between a pad and what it touches
_STEEP = np.cos(np.radians(30))  # of the approach against the vertical
_YAW_COST = 0.15  # score that a radian of turning the hand costs
_SAG = 0.004  # metres by which a kilogram in the hand keeps the arm below where it is told to go
_UP = np.array([0.0, 0.0, 0.03])  # metres, away from an object that the fingers have missed
_HIGH = 0.05  # metres that an object is lifted before it is carried sideways


@dataclass(frozen=True)
class PickObject:
    """Hover, descend, close, lift, carry.

    Positions are in the frame of the robot's base, whose z = 0 is the table's top; lengths in metres.
    """

    known: ObjectGrasps
    """Grasps and surface of the object that is to be picked up."""
    speed: float = 0.03
    """Longest translation asked of the controller in one step; it makes about a third of it."""

    def act(self, poses: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Action (7,) of ``pd_ee_delta_pose``.

        Args:
            poses: (4, 7) of hand, left finger, right finger and object.
            goal: (3,) for the object's origin.
        """
        tool, body = panda.tool_pose(poses), poses[3]
        points = _rotation(body).apply(self.known.cloud) + body[:3]
        if self._holds(tool, poses, points):
            return self._carry(tool, body, points, goal)
        grasp = self._choose(body)
        if grasp is None:
            return self._move(tool, np.zeros(3), None, 1.0)
        return self._reach(tool, body, points, grasp, panda.opening(poses))

    def _holds(self, tool: np.ndarray, poses: np.ndarray, points: np.ndarray) -> bool:
        """Whether both pads touch what is between them."""
        local = _rotation(tool).inv().apply(points - tool[:3])
        level = (np.abs(local[:, 0]) < PANDA.pad_half_width) & (np.abs(local[:, 2]) < PANDA.finger_tip)
        left, right = (_rotation(tool).inv().apply(poses[i, :3] - tool[:3])[1] for i in (1, 2))
        between = level & (local[:, 1] > right - 0.005) & (local[:, 1] < left + 0.005)
        if between.sum() < 2:
            return False
        y = local[between, 1]
        return bool(left - y.max() < _TOUCHING and y.min() - right < _TOUCHING)

    def _choose(self, body: np.ndarray) -> Grasp | None:
        """The best grasp from above for the present pose; turning the hand far from its rest costs."""
        if not self.known.grasps:
            return None
        turn = _rotation(body)
        steep = turn.apply([grasp.approach for grasp in self.known.grasps])[:, 2] <= -_STEEP
        closing = turn.apply([grasp.closing for grasp in self.known.grasps])
        yaw = np.abs(np.arctan2(closing[:, 1], closing[:, 0]) % np.pi - np.pi / 2)
        score = np.array([grasp.score for grasp in self.known.grasps]) - _YAW_COST * yaw
        if not steep.any():
            return None
        return self.known.grasps[int(np.where(steep, score, -np.inf).argmax())]

    def _reach(
        self, tool: np.ndarray, body: np.ndarray, points: np.ndarray, grasp: Grasp, opening: float
    ) -> np.ndarray:
        target = _rotation(body).apply(grasp.position) + body[:3]
        closing = _rotation(body).apply(grasp.closing)
        reach = target - tool[:3]
        beside, turn = float(np.linalg.norm(reach[:2])), downward_turn(tool, closing)
        askew = float(np.linalg.norm(turn))
        begun = opening < grasp.opening - 0.004
        if beside < (0.02 if begun else 0.004) and abs(reach[2]) < (0.02 if begun else 0.005) and askew < 0.15:
            missed = opening < grasp.width - 0.012
            return self._move(tool, _UP if missed else np.zeros(3), closing, 1.0 if missed else -1.0)
        wide = panda.gripper_command(grasp.opening)
        top = float(points[:, 2].max()) + PANDA.finger_tip + _CLEAR
        above = np.array([*reach[:2], top - tool[2]])
        if beside < 0.006 and askew < 0.08 and (above[2] < 0.01 or not begun):
            return self._move(tool, reach, closing, wide)
        if above[2] > 0.01:  # rise before moving sideways, or before opening what is jammed
            above[:2] = 0.0
        elif beside < 0.03 and above[2] < -0.01:  # wait above until aligned
            above[2] *= 0.3
        return self._move(tool, above, closing, wide)

    def _carry(self, tool: np.ndarray, body: np.ndarray, points: np.ndarray, goal: np.ndarray) -> np.ndarray:
        offset = goal - body[:3]
        low = float(points[:, 2].min())
        if np.linalg.norm(offset[:2]) > 0.03 and low < _HIGH:
            offset = np.array([0.0, 0.0, max(_HIGH + _NEAR_GOAL - low, offset[2])])
        offset[2] += _SAG * self.known.mass
        return self._move(tool, offset, None, -1.0)

    def _move(self, tool: np.ndarray, offset: np.ndarray, closing: np.ndarray | None, gripper: float) -> np.ndarray:
        slow = gripper < 0 and float(np.linalg.norm(offset)) < _NEAR_GOAL
        gain = _SLOW if slow else 1.0
        return servo(panda.PANDA, tool, tool[:3] + offset, closing, self.speed, gripper, gain)


def _rotation(pose: np.ndarray) -> Rotation:
    return Rotation.from_quat(pose[3:], scalar_first=True)
