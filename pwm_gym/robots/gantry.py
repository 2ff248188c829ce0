"""Kinematics of a gantry, batched over any leading dimensions; both ways are in closed form."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pwm_gym.robots.control import Gantry
from pwm_gym.scene.se3 import make_pose, matrix_from_pose7, rotation_about, rotation_parts

__all__ = ["GantryKinematics"]

# How far joints may be past their limits, which are springs: slides in metres, turns as a share of their range.
_STIFF, _SOFT = 0.03, 0.5


class GantryKinematics(nn.Module):
    """Kinematics of ``gantry``; poses are in the frame of all public poses."""

    origin: Tensor
    axis_parts: Tensor
    lower: Tensor
    upper: Tensor

    def __init__(self, gantry: Gantry) -> None:
        super().__init__()
        self._slides = list(gantry.slides)
        lower, upper = torch.tensor(gantry.lower), torch.tensor(gantry.upper)
        soft = _SOFT * (upper - lower)
        soft[: len(gantry.slides)] = _STIFF
        tables = {
            "origin": matrix_from_pose7(torch.tensor(gantry.origin, dtype=torch.float64)).float(),
            "axis_parts": rotation_parts(torch.eye(3)),  # (3, 3, 3, 3), of turns about x, y and z
            "lower": lower - soft,
            "upper": upper + soft,
        }
        for name, value in tables.items():
            self.register_buffer(name, value, persistent=False)

    def forward(self, joints: Tensor) -> Tensor:
        """Pose (..., 4, 4) of the hand at joint positions (..., J)."""
        count, origin = len(self._slides), self.origin.to(joints)
        axes = origin[:3, self._slides]
        place = origin[:3, 3] + joints[..., :count] @ axes.T
        x, y, z = rotation_about(self.axis_parts.to(joints), joints[..., count:]).unbind(-3)
        return make_pose(origin[:3, :3] @ x @ y @ z, place)

    def solve(self, hand: Tensor) -> Tensor:
        """Joint positions (..., J) at which the hand is at ``hand`` (..., 4, 4), or as near as the slides bring it."""
        origin = self.origin.to(hand)
        slid = (hand[..., :3, 3] - origin[:3, 3]) @ origin[:3, self._slides]
        turn = origin[:3, :3].T @ hand[..., :3, :3]
        x = torch.atan2(-turn[..., 1, 2], turn[..., 2, 2])
        y = torch.asin(turn[..., 0, 2].clamp(-1.0, 1.0))
        z = torch.atan2(-turn[..., 0, 1], turn[..., 0, 0])
        return torch.cat([slid, torch.stack([x, y, z], -1)], -1)

    def limit(self, joints: Tensor) -> Tensor:
        """Joint positions (..., J) within what their springs allow."""
        return torch.minimum(torch.maximum(joints, self.lower), self.upper)
