"""What is known of the robots that tasks drive: kinematic chains and the meaning of actions."""

from pwm_gym.robots.cloud import RobotCloud
from pwm_gym.robots.control import Arm, Channel, Control, Gantry, SerialArm
from pwm_gym.robots.gantry import GantryKinematics
from pwm_gym.robots.kinematics import ArmKinematics
from pwm_gym.robots.robot import Robot

__all__ = [
    "Arm",
    "ArmKinematics",
    "Channel",
    "Control",
    "Gantry",
    "GantryKinematics",
    "Robot",
    "RobotCloud",
    "SerialArm",
]
