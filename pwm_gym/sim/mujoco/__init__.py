"""Any MuJoCo model as a simulator. Importing this package loads no simulator."""

from pwm_gym.sim.mujoco.adapter import MujocoSimulator
from pwm_gym.sim.mujoco.describe import layout_of, robot_of
from pwm_gym.sim.mujoco.worlds import RoboticsWorld, World, XmlWorld

__all__ = ["MujocoSimulator", "RoboticsWorld", "World", "XmlWorld", "layout_of", "robot_of"]
