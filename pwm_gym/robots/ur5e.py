"""The UR5e with a Robotiq 2F-85 of OGBench, whose tool points down and turns about the vertical.

Its public frame is OGBench's world: the robot's base, on the table. The gripper's fingers swing on four-bar linkages,
of which a finger and the link that it hangs on are entities; the two other bars follow them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots.control import Arm, Channel, Control, SerialArm
from pwm_gym.robots.robot import Robot
from pwm_gym.scene import Layout, Support
from pwm_gym.scene.joint import Joint, Pose7
from pwm_gym.scene.poses import compose

__all__ = ["UR5E", "layout", "opening", "tool_pose", "yaw_action"]

_GRIPPER = "ur5e/robotiq/"
_LINKS = {
    "hand": f"{_GRIPPER}base",
    "left_link": f"{_GRIPPER}left_spring_link",
    "left_gripper": f"{_GRIPPER}left_follower",
    "right_link": f"{_GRIPPER}right_spring_link",
    "right_gripper": f"{_GRIPPER}right_follower",
}
_AXIS = (1.0, 0.0, 0.0)
_LEFT: Pose7 = (0.0, -0.0132, 0.0609, 0.0, 0.0, 0.0, 1.0)  # 2f85.xml's spring links and followers
_RIGHT: Pose7 = (0.0, 0.0132, 0.0609, 1.0, 0.0, 0.0, 0.0)
_FINGER: Pose7 = (0.0, 0.037, 0.044, 1.0, 0.0, 0.0, 0.0)
_JOINTS = {
    "left_link": Joint("revolute", "hand", _LEFT, _AXIS, -0.29670597283, 0.8),
    "left_gripper": Joint("revolute", "left_link", _FINGER, _AXIS, -0.872664, 0.872664),
    "right_link": Joint("revolute", "hand", _RIGHT, _AXIS, -0.29670597283, 0.8),
    "right_gripper": Joint("revolute", "right_link", _FINGER, _AXIS, -0.872664, 0.872664),
}
_TOOL: Pose7 = (0.0, 0.0, 0.145, 1.0, 0.0, 0.0, 0.0)  # the site `pinch`
_PAD = (0.0, -0.0075, 0.0258)  # metres: middle of a pad's inner face in a finger's frame
_HALF = 0.5**0.5
_TURN = 2.0 * np.pi
_CHAIN = SerialArm(
    origins=(
        (0.0, 0.0, 0.163, _HALF, 0.0, 0.0, _HALF),
        (0.0, 0.138, 0.0, 0.5, -0.5, 0.5, 0.5),
        (0.0, -0.425, -0.131, 1.0, 0.0, 0.0, 0.0),
        (0.0, -0.392, 0.0, _HALF, 0.0, 0.0, _HALF),
        (0.0, 0.0, 0.127, _HALF, _HALF, 0.0, 0.0),
        (0.0, 0.0, 0.1, _HALF, -_HALF, 0.0, 0.0),
    ),
    mount=(0.0, 0.0, 0.1108, _HALF, 0.0, 0.0, -_HALF),
    tool=_TOOL[:3],
    lower=(-_TURN, -_TURN, -3.1415, -_TURN, -_TURN, -_TURN),
    upper=(_TURN, _TURN, 3.1415, _TURN, _TURN, _TURN),
    rest=(-np.pi / 2, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0),
    bounds=((0.25, -0.35, 0.02), (0.6, 0.35, 0.35)),
)
"""ur5e.xml's joints, each about its z axis here, and the gripper on the flange."""
_POSITION_UNIT, _YAW_UNIT = 0.05, 0.3  # metres, and radians, per unit of an action
_CONTROL = Control(
    channels=(
        Channel("translation", 0, 3, _POSITION_UNIT, arm="arm"),
        Channel("yaw", 3, 4, _YAW_UNIT, arm="arm"),
        Channel("gripper", 4, 5, rest=1.0, arm="arm"),
    ),
    arms=(Arm("arm", "hand", _CHAIN),),
    period=0.05,
)
"""The controller solves inverse kinematics for the present tool's pose changed by an action; of the way the arm makes
40 % in a step, and its drives let it sink by 1 mm a step where nothing is asked for."""


def tool_pose(poses: np.ndarray) -> np.ndarray:
    """Tool centre pose (7,) between the pads, its z axis down, of entity poses (E, 7) whose first is the hand."""
    return compose(poses[0], np.array(_TOOL))


def opening(poses: np.ndarray) -> float:
    """Distance in metres between the middles of the pads, of entity poses (E, 7) that begin with the robot's."""
    left, right = (_pad(poses[[*_LINKS].index(finger)]) for finger in ("left_gripper", "right_gripper"))
    return float(np.linalg.norm(left - right))


def _pad(finger: np.ndarray) -> np.ndarray:
    """Middle (3,) of the pad of a finger at a pose (7,)."""
    return Rotation.from_quat(finger[3:], scalar_first=True).apply(_PAD) + finger[:3]


def yaw_action(translation: np.ndarray, rotation: np.ndarray, gripper: float) -> np.ndarray:
    """Action (5,).

    Args:
        translation: (3,) metres, base frame.
        rotation: rotation vector (3,), of which the vertical part counts: the tool keeps pointing down.
        gripper: 1 open, -1 shut.
    """
    action = np.r_[translation / _POSITION_UNIT, rotation[2] / _YAW_UNIT, gripper]
    return np.clip(action, -1.0, 1.0).astype(np.float32)


UR5E = Robot(
    name="ur5e",
    links=_LINKS,
    control=_CONTROL,
    joints=_JOINTS,
    tool=tool_pose,
    opening=opening,
    action=yaw_action,
    action_names=("dx", "dy", "dz", "dyaw", "gripper"),
)


def layout(objects: Mapping[str, int]) -> Layout:
    """The hand, its fingers and their links, and loose objects (name -> points) on the table."""
    points = dict.fromkeys(_LINKS, 300) | {"left_link": 150, "right_link": 150}
    return Layout.build(
        [*points.items(), *objects.items()], driven=UR5E.driven, joints=UR5E.joints, supports=[Support.ground(0.0)]
    )
