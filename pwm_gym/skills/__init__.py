"""What scripted experts share: skills without memory, whose phases are told from poses alone (NumPy)."""

from pwm_gym.skills.brew import Brew
from pwm_gym.skills.carry import Carry
from pwm_gym.skills.clean_up import CleanUp
from pwm_gym.skills.cube_oracle import CubeOracle
from pwm_gym.skills.fill_drawer import FillDrawer
from pwm_gym.skills.grasp import TopGrasp
from pwm_gym.skills.hand_reach import HandReach
from pwm_gym.skills.motion import downward_turn, drive, servo, side_yaw, tool_pose, yaw_error
from pwm_gym.skills.object_grasps import Grasp, ObjectGrasps, find_grasps
from pwm_gym.skills.open_drawer import OpenDrawer
from pwm_gym.skills.pick import PickObject
from pwm_gym.skills.pinch import Pinch
from pwm_gym.skills.place import Place
from pwm_gym.skills.prepare import Prepare
from pwm_gym.skills.push import Push
from pwm_gym.skills.put_lid import PutLid
from pwm_gym.skills.table_push import TablePush
from pwm_gym.skills.table_tap import TableTap

__all__ = [
    "Brew",
    "Carry",
    "CleanUp",
    "CubeOracle",
    "FillDrawer",
    "Grasp",
    "HandReach",
    "ObjectGrasps",
    "OpenDrawer",
    "PickObject",
    "Pinch",
    "Place",
    "Prepare",
    "Push",
    "PutLid",
    "TablePush",
    "TableTap",
    "TopGrasp",
    "downward_turn",
    "drive",
    "find_grasps",
    "servo",
    "side_yaw",
    "tool_pose",
    "yaw_error",
]
