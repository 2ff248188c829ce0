"""What scripted experts share: skills without memory, whose phases are told from poses alone (NumPy)."""

from pwm_gym.skills.grasp import TopGrasp
from pwm_gym.skills.motion import drive, side_yaw, tool_pose, yaw_error
from pwm_gym.skills.object_grasps import Grasp, ObjectGrasps, find_grasps
from pwm_gym.skills.pick import PickObject
from pwm_gym.skills.place import Place

__all__ = [
    "Grasp",
    "ObjectGrasps",
    "PickObject",
    "Place",
    "TopGrasp",
    "drive",
    "find_grasps",
    "side_yaw",
    "tool_pose",
    "yaw_error",
]
