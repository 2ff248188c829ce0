"""The Franka Panda hand as the Panda tasks share it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.scene import Slider
from pwm_gym.tasks.registry import ActionFrame, Arm

__all__ = [
    "ACTION_FRAME",
    "ACTION_NAMES",
    "ARM",
    "BODIES",
    "EFFECTORS",
    "SLIDERS",
    "delta_pose_action",
    "opening",
    "tool_pose",
]

BODIES = {"hand": "panda_hand", "left_gripper": "panda_leftfinger", "right_gripper": "panda_rightfinger"}
EFFECTORS = tuple(BODIES)
_FINGER_ORIGIN = (0.0, 0.0, 0.0584, 1.0, 0.0, 0.0, 0.0)  # the URDF's panda_finger_joint1 and 2
SLIDERS = {
    "left_gripper": Slider("hand", _FINGER_ORIGIN, (0.0, 1.0, 0.0), 0.04),
    "right_gripper": Slider("hand", _FINGER_ORIGIN, (0.0, -1.0, 0.0), 0.04),
}
_TOOL_OFFSET = 0.1034  # metres along the hand's z axis: the URDF's panda_hand_tcp
_POSITION_UNIT = 0.1  # metres per unit of pd_ee_delta_pose
_ROTATION_UNIT = -0.1  # radians per unit; the controller scales by its lower bound, hence the sign
ACTION_NAMES = ("dx", "dy", "dz", "rotation x", "rotation y", "rotation z", "gripper")
ACTION_FRAME = ActionFrame(vectors=((0, 3), (3, 6)))


def tool_pose(poses: np.ndarray) -> np.ndarray:
    """Tool centre pose (7,) between the finger tips, of entity poses (E, 7) whose first is the hand."""
    hand = poses[0]
    down = Rotation.from_quat(hand[3:], scalar_first=True).apply([0.0, 0.0, _TOOL_OFFSET])
    return np.concatenate([hand[:3] + down, hand[3:]])


def opening(poses: np.ndarray) -> float:
    """Distance in metres between the finger pads, of entity poses (E, 7) (hand, left, right, ...)."""
    return float(np.linalg.norm(poses[1, :3] - poses[2, :3]))


def delta_pose_action(translation: np.ndarray, rotation: np.ndarray, gripper: float) -> np.ndarray:
    """Action (7,) of ``pd_ee_delta_pose``.

    Args:
        translation: (3,) metres, base frame.
        rotation: rotation vector (3,), radians, base frame.
        gripper: 1 open, -1 shut.
    """
    action = np.concatenate([translation / _POSITION_UNIT, rotation / _ROTATION_UNIT, [gripper]])
    return np.clip(action, -1.0, 1.0).astype(np.float32)


ARM = Arm(tool=tool_pose, action=delta_pose_action)
