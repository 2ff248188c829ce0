"""What scripted experts share: skills without memory, whose phases are told from poses alone (NumPy)."""

from pwm_gym.skills.grasp import TopGrasp
from pwm_gym.skills.motion import drive, side_yaw, tool_pose, yaw_error
from pwm_gym.skills.place import Place

__all__ = ["Place", "TopGrasp", "drive", "side_yaw", "tool_pose", "yaw_error"]
