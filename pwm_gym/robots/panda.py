"""The Franka Emika Panda with its parallel gripper, driven by changes of its tool's pose."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots.cloud import RobotCloud
from pwm_gym.robots.control import Arm, Channel, Control, SerialArm
from pwm_gym.robots.robot import Robot
from pwm_gym.robots.speeds import JointSpeeds
from pwm_gym.scene import Layout, Support
from pwm_gym.scene.joint import Joint, Pose7

__all__ = [
    "JOINT_SPEEDS",
    "PANDA",
    "delta_pose_action",
    "gripper_command",
    "layout",
    "opening",
    "robot_cloud",
    "tool_pose",
]

_LINKS = {"hand": "panda_hand", "left_gripper": "panda_leftfinger", "right_gripper": "panda_rightfinger"}
_FINGER_ORIGIN: Pose7 = (0.0, 0.0, 0.0584, 1.0, 0.0, 0.0, 0.0)  # the URDF's panda_finger_joint1 and 2
_FINGERS = {
    "left_gripper": Joint("prismatic", "hand", _FINGER_ORIGIN, (0.0, 1.0, 0.0), 0.0, 0.04),
    "right_gripper": Joint("prismatic", "hand", _FINGER_ORIGIN, (0.0, -1.0, 0.0), 0.0, 0.04),
}
_TOOL_OFFSET = 0.1034  # metres along the hand's z axis: the URDF's panda_hand_tcp
_POSITION_UNIT = 0.1  # metres per unit of pd_ee_delta_pose
_ROTATION_UNIT = -0.1  # radians per unit; the controller scales by its lower bound, hence the sign
_ACTION_NAMES = ("dx", "dy", "dz", "rotation x", "rotation y", "rotation z", "gripper")
_HALF = 0.5**0.5
_BACK, _FORTH = (_HALF, -_HALF, 0.0, 0.0), (_HALF, _HALF, 0.0, 0.0)  # quarter turns about x
_CHAIN = SerialArm(
    origins=(
        (0.0, 0.0, 0.333, 1.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, *_BACK),
        (0.0, -0.316, 0.0, *_FORTH),
        (0.0825, 0.0, 0.0, *_FORTH),
        (-0.0825, 0.384, 0.0, *_BACK),
        (0.0, 0.0, 0.0, *_FORTH),
        (0.088, 0.0, 0.0, *_FORTH),
    ),
    mount=(0.0, 0.0, 0.107, float(np.cos(np.pi / 8)), 0.0, 0.0, -float(np.sin(np.pi / 8))),
    tool=(0.0, 0.0, _TOOL_OFFSET),
    lower=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    upper=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    rest=(0.0, np.pi / 8, 0.0, -np.pi * 5 / 8, 0.0, np.pi * 3 / 4, np.pi / 4),
)
"""The URDF's panda_joint1 to 7 and panda_hand_joint."""
_CONTROL = Control(
    channels=(
        Channel("translation", 0, 3, _POSITION_UNIT, arm="arm"),
        Channel("rotation", 3, 6, _ROTATION_UNIT, arm="arm"),
        Channel("gripper", 6, 7, rest=1.0, arm="arm"),
    ),
    arms=(Arm("arm", "hand", _CHAIN),),
    period=0.05,
)
"""ManiSkill's ``pd_ee_delta_pose`` at 20 Hz."""
JOINT_SPEEDS = JointSpeeds(
    joints=7,
    period=_CONTROL.period,
    bending=((2.05, -1.57), (3.38, 0.585), (-0.444, -2.16)),
    averaged=0.87,
)
"""Of the second, fourth and sixth joint, over a table-top: least squares on recorded PickCube demonstrations."""


def robot_cloud() -> RobotCloud:
    """The hand and its fingers from nine joint values, of the URDF that ManiSkill's Panda is built from."""
    from mani_skill import PACKAGE_ASSET_DIR

    urdf = PACKAGE_ASSET_DIR / "robots" / "panda" / "panda_v2.urdf"
    return RobotCloud.from_urdf(urdf, _LINKS.values(), names=_LINKS, convex=True)


def tool_pose(poses: np.ndarray) -> np.ndarray:
    """Tool centre pose (7,) between the finger tips, of entity poses (E, 7) whose first is the hand."""
    hand = poses[0]
    down = Rotation.from_quat(hand[3:], scalar_first=True).apply([0.0, 0.0, _TOOL_OFFSET])
    return np.concatenate([hand[:3] + down, hand[3:]])


def opening(poses: np.ndarray) -> float:
    """Distance in metres between the finger pads, of entity poses (E, 7) (hand, left, right, ...)."""
    return float(np.linalg.norm(poses[1, :3] - poses[2, :3]))


def gripper_command(width: float) -> float:
    """Gripper's part of an action for a distance in metres between the pads: half of it is -0.01 at -1, 0.04 at 1."""
    return float(np.clip((width / 2 + 0.01) / 0.025 - 1.0, -1.0, 1.0))


def delta_pose_action(translation: np.ndarray, rotation: np.ndarray, gripper: float) -> np.ndarray:
    """Action (7,) of ``pd_ee_delta_pose``.

    Args:
        translation: (3,) metres, base frame.
        rotation: rotation vector (3,), radians, base frame.
        gripper: 1 open, -1 shut.
    """
    action = np.concatenate([translation / _POSITION_UNIT, rotation / _ROTATION_UNIT, [gripper]])
    return np.clip(action, -1.0, 1.0).astype(np.float32)


PANDA = Robot(
    name="panda",
    links=_LINKS,
    control=_CONTROL,
    joints=_FINGERS,
    cloud=robot_cloud,
    tool=tool_pose,
    opening=opening,
    action=delta_pose_action,
    action_names=_ACTION_NAMES,
)


def layout(objects: Mapping[str, int], points: int = 300, joints: Mapping[str, Joint] | None = None) -> Layout:
    """The Panda's links with ``points`` points each, and objects (name -> points) on the ground.

    Args:
        objects: loose where :obj:`joints` does not say otherwise.
        points: of each link.
        joints: object -> how it hangs on its parent.
    """
    return Layout.build(
        [*((link, points) for link in _LINKS), *objects.items()],
        driven=PANDA.driven,
        joints={**PANDA.joints, **(joints or {})},
        supports=[Support.ground()],
    )
