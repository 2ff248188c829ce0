"""The Fetch arm of Gymnasium-Robotics, whose hand points down and is dragged by a mocap body.

Its public frame is that of the robot's base, lifted to the table's top: what lies on the table is at height 0, as for
robots that stand on their table.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pwm_gym.robots.control import Arm, Channel, Control
from pwm_gym.robots.robot import Robot
from pwm_gym.scene import Layout, Support
from pwm_gym.scene.joint import Joint, Pose7
from pwm_gym.scene.poses import compose

__all__ = ["FETCH", "TABLE", "TABLE_HEIGHT", "WIDE_TABLE", "layout", "opening", "tool_pose", "translation_action"]

TABLE_HEIGHT = 0.4
"""Metres from the ground that the robot stands on to the table's top."""

_LINKS = {
    "hand": "robot0:gripper_link",
    "left_gripper": "robot0:l_gripper_finger_link",
    "right_gripper": "robot0:r_gripper_finger_link",
}
_LEFT: Pose7 = (0.0, -0.0159, 0.0, 1.0, 0.0, 0.0, 0.0)  # robot.xml's finger links
_RIGHT: Pose7 = (0.0, 0.0159, 0.0, 1.0, 0.0, 0.0, 0.0)
_FINGERS = {
    "left_gripper": Joint("prismatic", "hand", _LEFT, (0.0, -1.0, 0.0), 0.0, 0.05),
    "right_gripper": Joint("prismatic", "hand", _RIGHT, (0.0, 1.0, 0.0), 0.0, 0.05),
}
_HALF = 0.5**0.5
_TOOL: Pose7 = (0.02, 0.0, 0.0, _HALF, 0.0, _HALF, 0.0)  # the site robot0:grip, its z axis along the hand's x
_PAD = 0.015  # metres from a finger link's origin inward to its pad
_POSITION_UNIT = 0.05  # metres per unit of an action
_CONTROL = Control(
    channels=(
        Channel("translation", 0, 3, _POSITION_UNIT, arm="arm"),
        Channel("gripper", 3, 4, rest=1.0, arm="arm"),
    ),
    arms=(Arm("arm", "hand"),),
    period=0.04,
)
"""The mocap body goes an action's way from where the hand is; how the hand follows is fitted."""

TABLE = Support((0.6081, 0.0059, -0.2, 1.0, 0.0, 0.0, 0.0), (0.25, 0.35, 0.2))
"""Of all tasks but the sliding one."""
WIDE_TABLE = Support((0.98752, 0.00608, -0.2, 1.0, 0.0, 0.0, 0.0), (0.625, 0.45, 0.2))
"""Of the sliding task."""


def tool_pose(poses: np.ndarray) -> np.ndarray:
    """Tool centre pose (7,) between the pads, its z axis down, of entity poses (E, 7) whose first is the hand."""
    return compose(poses[0], np.array(_TOOL))


def opening(poses: np.ndarray) -> float:
    """Distance in metres between the finger pads, of entity poses (E, 7) (hand, left, right, ...)."""
    return float(np.linalg.norm(poses[1, :3] - poses[2, :3])) - 2 * _PAD


def translation_action(translation: np.ndarray, rotation: np.ndarray, gripper: float) -> np.ndarray:
    """Action (4,).

    Args:
        translation: (3,) metres, base frame.
        rotation: rotation vector (3,); left out, since the hand keeps pointing down.
        gripper: 1 open, -1 shut.
    """
    return np.clip(np.r_[translation / _POSITION_UNIT, gripper], -1.0, 1.0).astype(np.float32)


FETCH = Robot(
    name="fetch",
    links=_LINKS,
    control=_CONTROL,
    joints=_FINGERS,
    tool=tool_pose,
    opening=opening,
    action=translation_action,
    action_names=("dx", "dy", "dz", "gripper"),
)


def layout(objects: Mapping[str, int], table: Support = TABLE, points: int = 300) -> Layout:
    """The hand and its fingers with ``points`` points each, and loose objects (name -> points) on the table."""
    return Layout.build(
        [*((link, points) for link in _LINKS), *objects.items()],
        driven=FETCH.driven,
        joints=FETCH.joints,
        supports=[table, Support.ground(-TABLE_HEIGHT)],
    )
