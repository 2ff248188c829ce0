"""What scripted experts share: skills without memory, whose phases are told from poses alone (NumPy)."""

from pwm_gym.skills.grasp import TopGrasp
from pwm_gym.skills.motion import drive, position, rotation_about_z, yaw_error
from pwm_gym.skills.place import Place

__all__ = ["Place", "TopGrasp", "drive", "position", "rotation_about_z", "yaw_error"]
