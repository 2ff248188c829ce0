"""Depth cameras: what one of them sees of a scene, by ray casting, without a GPU."""

from pwm_gym.cameras.camera import DepthCamera
from pwm_gym.cameras.raycast import RayCaster, View

__all__ = ["DepthCamera", "RayCaster", "View"]
