"""What our own ManiSkill tasks share: a Panda at a table, two cameras, and small tensors."""

from __future__ import annotations

import numpy as np
import sapien
import torch
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils import sapien_utils

__all__ = ["ROBOT_BASE", "about_z", "nearness", "render_camera", "sensor_camera"]

ROBOT_BASE = sapien.Pose([-0.615, 0.0, 0.0])
"""As in ManiSkill's tasks on a table."""


def sensor_camera() -> CameraConfig:
    """Camera of observations, beside the robot."""
    pose = sapien_utils.look_at(eye=[-0.3, -0.5, 0.6], target=[0.05, 0.0, 0.05])
    return CameraConfig("base_camera", pose, 128, 128, np.pi / 2, 0.01, 100)


def render_camera() -> CameraConfig:
    """Camera of videos."""
    pose = sapien_utils.look_at([-0.4, -0.7, 0.7], [0.05, 0.0, 0.1])
    return CameraConfig("render_camera", pose, 512, 512, 1, 0.01, 100)


def nearness(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """1 where points (B, 3) coincide, falling with their distance: (B,)."""
    return 1.0 - torch.tanh(5.0 * torch.linalg.norm(a - b, dim=-1))


def about_z(angle: torch.Tensor) -> torch.Tensor:
    """Quaternions (B, 4) of turns (B,) about the vertical."""
    zero = torch.zeros_like(angle)
    return torch.stack([torch.cos(0.5 * angle), zero, zero, torch.sin(0.5 * angle)], -1)
