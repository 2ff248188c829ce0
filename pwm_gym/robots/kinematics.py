"""Forward and inverse kinematics of a serial arm, batched over any leading dimensions and differentiable.

A planner's rollout calls them several times a step for hundreds of arms; these few tensor operations take a tenth of
the time of a general kinematics library, which the tests compare them with.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.robots.control import SerialArm
from pwm_gym.scene.se3 import make_pose, matrix_from_pose7, rotation_about, rotation_parts

__all__ = ["ArmKinematics"]

_DAMPING = 1e-6  # of the least squares, in squared metres: next to a singularity steps stay finite


class ArmKinematics(nn.Module):
    """Kinematics of ``arm``; poses are in the base's frame."""

    joint_parts: Tensor
    axis_parts: Tensor
    mount: Tensor
    tool: Tensor
    grip: Tensor
    lower: Tensor
    upper: Tensor
    rest: Tensor
    damping: Tensor
    bounds: Tensor

    def __init__(self, arm: SerialArm) -> None:
        super().__init__()
        self.arm = arm
        origins, mount = (
            matrix_from_pose7(torch.tensor(pose, dtype=torch.float64)) for pose in (arm.origins, arm.mount)
        )
        tool, axes = torch.tensor(arm.tool, dtype=torch.float64), torch.eye(3, dtype=torch.float64)
        joints = F.pad(rotation_parts(axes[2]), (0, 1, 0, 1))  # about z
        joints[0, 3, 3] = 1.0
        tables = {
            "joint_parts": origins @ joints.unsqueeze(1),  # (3, J, 4, 4), of each joint's frame in the one before it
            "axis_parts": rotation_parts(axes),  # (3, 3, 3, 3), of turns about x, y and z
            "mount": mount,
            "tool": tool,
            "grip": make_pose(axes, tool),  # the tool's frame in the hand's
            "lower": torch.tensor(arm.lower),
            "upper": torch.tensor(arm.upper),
            "rest": torch.tensor(arm.rest),
            "damping": _DAMPING * torch.eye(6),
            "bounds": torch.tensor(arm.bounds or ((-torch.inf,) * 3, (torch.inf,) * 3)),
        }
        self._bounded = arm.bounds is not None
        for name, value in tables.items():
            self.register_buffer(name, value.float(), persistent=False)

    def frames(self, joints: Tensor) -> Tensor:
        """Poses (..., J, 4, 4) of the joints' frames at angles (..., J); each joint's axis is its frame's z."""
        local = rotation_about(self.joint_parts.to(joints), joints).flatten(0, -4).unbind(1)
        poses = [local[0]]
        for pose in local[1:]:
            poses.append(torch.bmm(poses[-1], pose))  # a general product costs half as much again for so few numbers
        return torch.stack(poses, 1).unflatten(0, joints.shape[:-1])

    def forward(self, joints: Tensor) -> Tensor:
        """Pose (..., 4, 4) of the end effector's hand at joint angles (..., J)."""
        return self.frames(joints)[..., -1, :, :] @ self.mount.to(joints)

    def jacobian(self, frames: Tensor, point: Tensor) -> Tensor:
        """(..., 6, J): velocity of a point (..., 3) of the last link, and angular velocity, per joint velocity."""
        axes, origins = frames[..., :3, 2], frames[..., :3, 3]  # (..., J, 3)
        linear = torch.linalg.cross(axes, point.unsqueeze(-2) - origins)
        return torch.cat([linear, axes], -1).transpose(-1, -2)

    def solve(self, goal: Tensor, start: Tensor, iterations: int = 4, rate: float = 1.0) -> tuple[Tensor, Tensor]:
        """Inverse kinematics by damped Gauss-Newton steps.

        Args:
            goal: pose (..., 4, 4) of the hand.
            start: joint angles (..., J) to begin at; the solution is close to them.
            iterations: steps.
            rate: share of each step that is taken; less finds solutions past which whole steps shoot.

        Returns:
            Joint angles (..., J), and the distance (...) in metres by which the tool centre misses its goal.
        """
        joints, _, _ = self.approach(goal, start, iterations, rate)
        way = self._tool(self(joints)) - self._tool(goal)
        return joints, way[..., :3, 3].norm(dim=-1)

    def approach(
        self, goal: Tensor, start: Tensor, iterations: int, rate: float = 1.0
    ) -> tuple[Tensor, Tensor, Tensor]:
        """As :meth:`solve`, but with what is known before the last step, which saves the last forward kinematics.

        Returns:
            Joint angles (..., J), the distance (...) by which the tool missed its goal before the last step, and that
            step's length (...) in radians. Whole steps square the error: half the length's square, in metres, is left.
        """
        goal, mount = self._tool(goal), self._tool(self.mount.to(start))
        joints, error, step = start, torch.full_like(start, torch.inf), torch.full_like(start, torch.inf)
        for _ in range(iterations):
            frames = self.frames(joints)
            tool = frames[..., -1, :, :] @ mount
            error = _error(goal, tool)
            jacobian = self.jacobian(frames, tool[..., :3, 3])
            gram = jacobian @ jacobian.transpose(-1, -2) + self.damping.to(start)
            step = (jacobian.transpose(-1, -2) @ torch.linalg.solve(gram, error.unsqueeze(-1))).squeeze(-1)
            joints = torch.add(joints, step, alpha=rate)
        return joints, error[..., :3].norm(dim=-1), rate * step.norm(dim=-1)

    def target(
        self, hand: Tensor, translation: Tensor, angles: Tensor | None = None, yaw: Tensor | None = None
    ) -> Tensor:
        """Pose (..., 4, 4) that the hand at ``hand`` (..., 4, 4) is asked to take, its tool within the arm's bounds.

        Args:
            hand: its present pose.
            translation: of the tool (..., 3), metres.
            angles: turns (..., 3) about x, then y, then z, radians; None keeps the hand's rotation.
            yaw: turn (..., 1) about the vertical, radians, of a tool that is to point straight down.
        """
        rotation = hand[..., :3, :3]
        if angles is not None:
            x, y, z = rotation_about(self.axis_parts.to(hand), angles).unbind(-3)
            rotation = x @ y @ z @ rotation
        if yaw is not None:
            rotation = _downward(rotation, yaw)
        tool = self._tool(hand)[..., :3, 3] + translation
        if self._bounded:
            lower, upper = self.bounds.to(hand)
            tool = torch.minimum(torch.maximum(tool, lower), upper)
        return make_pose(rotation, tool - rotation @ self.tool.to(hand))

    def limit(self, joints: Tensor) -> Tensor:
        """Joint angles (..., J) within their limits."""
        return torch.minimum(torch.maximum(joints, self.lower), self.upper)

    def _tool(self, hand: Tensor) -> Tensor:
        """Pose (..., 4, 4) of the tool on a hand at (..., 4, 4)."""
        return hand @ self.grip.to(hand)


def _downward(rotation: Tensor, yaw: Tensor) -> Tensor:
    """Rotations (..., 3, 3) whose z axis points down, turned by ``yaw`` (..., 1) from the given ones' x axis."""
    x, y = rotation[..., 0, 0], rotation[..., 1, 0]
    angle = torch.atan2(y, x) + yaw.squeeze(-1)
    cosine, sine, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    rows = [cosine, sine, zero, sine, -cosine, zero, zero, zero, -one]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def _error(goal: Tensor, tool: Tensor) -> Tensor:
    """Way (..., 6) from the tool's pose to its goal (..., 4, 4): metres, and the turn's axis times its sine."""
    turn = 0.5 * torch.linalg.cross(tool[..., :3, :3], goal[..., :3, :3], dim=-2).sum(-1)
    return torch.cat([goal[..., :3, 3] - tool[..., :3, 3], turn], -1)
