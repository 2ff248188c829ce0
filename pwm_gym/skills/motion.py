"""Straight motions of the tool, and turns that align its fingers."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Robot

__all__ = ["downward_turn", "drive", "servo", "side_yaw", "tool_pose", "yaw_error"]

_FASTEST_TURN = 0.1  # radians a step
_GAIN = 1.5  # of the servo: the controller lags and makes a part of what it is asked for


def tool_pose(robot: Robot, poses: np.ndarray) -> np.ndarray:
    """Tool centre pose (7,) of scene poses (E, 7).

    Raises:
        PwmGymError: the robot has no tool.
    """
    if robot.tool is None:
        raise PwmGymError(f"robot {robot.name!r} has no tool; scripted skills need one")
    return robot.tool(poses)


def drive(robot: Robot, offset: np.ndarray, speed: float, gripper: float, turn: float = 0.0) -> np.ndarray:
    """Action (A,) that moves the tool straight by ``offset``, as far as ``speed`` lets it in a step.

    Args:
        robot: that is driven.
        offset: way to go (3,), metres, base frame.
        speed: longest translation asked for in a step, metres.
        gripper: 1 open, -1 shut.
        turn: about the vertical axis, radians; at most 0.1 are asked for in a step.
    """
    if robot.action is None:
        raise PwmGymError(f"robot {robot.name!r} has no action of a tool's motion; scripted skills need one")
    distance = float(np.linalg.norm(offset))
    step = offset * min(1.0, speed / max(distance, 1e-9))
    rotation = np.array([0.0, 0.0, np.clip(turn, -_FASTEST_TURN, _FASTEST_TURN)])
    return robot.action(step, rotation, gripper)


def servo(
    robot: Robot,
    tool: np.ndarray,
    target: np.ndarray,
    closing: np.ndarray | None,
    speed: float,
    gripper: float,
    gain: float = 1.0,
) -> np.ndarray:
    """Action (A,) that moves the tool straight to a place, pointing down, its fingers along a direction.

    Args:
        robot: that is driven.
        tool: tool pose (7,).
        target: place (3,) of the tool, base frame.
        closing: horizontal direction (3,) along which the fingers shall close, the one way or the other; None keeps
            their own.
        speed: longest translation asked for in a step, metres.
        gripper: 1 open, -1 shut.
        gain: share of the usual translation; a heavy load comes to rest with less.
    """
    if robot.action is None:
        raise PwmGymError(f"robot {robot.name!r} has no action of a tool's motion; scripted skills need one")
    offset = target - tool[:3]
    step = offset * min(_GAIN * gain, speed / max(float(np.linalg.norm(offset)), 1e-9))
    turn = _GAIN * downward_turn(tool, closing)
    turn *= min(1.0, _FASTEST_TURN / max(float(np.linalg.norm(turn)), 1e-9))
    return robot.action(step, turn, gripper)


def downward_turn(tool: np.ndarray, closing: np.ndarray | None) -> np.ndarray:
    """Rotation vector (3,) that points the tool down and its fingers along ``closing``, the shorter way round.

    Args:
        tool: tool pose (7,).
        closing: direction (3,), whose horizontal part counts; None keeps the fingers' own.
    """
    now = Rotation.from_quat(tool[3:], scalar_first=True)
    y = now.apply([0.0, 1.0, 0.0]) if closing is None else np.array([closing[0], closing[1], 0.0])
    y = np.array([y[0], y[1], 0.0]) / max(float(np.hypot(y[0], y[1])), 1e-9)
    if y @ now.apply([0.0, 1.0, 0.0]) < 0:
        y = -y
    down = np.array([0.0, 0.0, -1.0])
    wanted = Rotation.from_matrix(np.stack([np.cross(y, down), y, down], -1))
    return (wanted * now.inv()).as_rotvec()


def side_yaw(pose: np.ndarray) -> float:
    """Direction, radians about the vertical axis, of a side of a box at ``pose`` (7,) that lies flat."""
    sides = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
    side = sides[:, np.argmin(np.abs(sides[2]))]
    return float(np.arctan2(side[1], side[0]))


def yaw_error(tool: np.ndarray, pose: np.ndarray) -> float:
    """Smallest turn about the vertical axis, radians, that aligns the fingers with two sides of a box.

    Args:
        tool: tool pose (7,); the fingers move along its y axis.
        pose: of the box (7,).
    """
    x_tool = Rotation.from_quat(tool[3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    error = side_yaw(pose) - np.arctan2(x_tool[1], x_tool[0])
    return float((error + np.pi / 4) % (np.pi / 2) - np.pi / 4)
