"""What is known of the robots that tasks drive: kinematic chains and the meaning of actions."""

from pwm_gym.robots.cloud import RobotCloud
from pwm_gym.robots.control import Control, SerialArm
from pwm_gym.robots.kinematics import ArmKinematics

__all__ = ["ArmKinematics", "Control", "RobotCloud", "SerialArm"]
