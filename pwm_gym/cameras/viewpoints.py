"""Where cameras stand that look at a table-top robot's work area, in the robot base's frame."""

from __future__ import annotations

from pwm_gym.cameras import DepthCamera

__all__ = ["CAMERA", "CAMERA_SCALE", "VIEWPOINTS"]

CAMERA = DepthCamera.looking((1.15, -0.55, 0.65), (0.6, 0.0, 0.15), fov=50.0)
"""In front of a table-top robot, to its right, looking down at its work area."""

VIEWPOINTS = {
    "right": CAMERA,
    "left": DepthCamera.looking((1.15, 0.55, 0.65), (0.6, 0.0, 0.15), fov=50.0),
    "front": DepthCamera.looking((1.3, 0.0, 0.75), (0.6, 0.0, 0.15), fov=50.0),
}
""":data:`CAMERA` and two others, to see what the viewpoint changes."""

CAMERA_SCALE = 2
"""Pixels of completion's camera for each of :data:`CAMERA`'s: objects of a few centimetres need a dozen across."""
