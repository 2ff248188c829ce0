"""How an arm's joints respond to actions: its controller's kinematics are known, its drives' dynamics are fitted.

The joints' next step is linear in their two last steps and in the way that is left to the controller's solution of
inverse kinematics, plus a small learned remainder (torque limits, inertia, gravity's load) that vanishes at rest.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.robots import ArmKinematics, SerialArm

__all__ = ["ArmResponse"]

_UNSOLVED = 1e-3  # metres by which a solution may miss; ManiSkill's solver gives up there, and the arm stays
_ITERATIONS = 3
_STEP = 0.01  # radians a step: the remainder's unit
_QUIET = 1e-4  # radians: below it an arm is at rest
_FIT_BATCH, _FIT_RATE = 1024, 2e-3


class ArmResponse(nn.Module):
    """Joint steps under actions.

    Args:
        arm: its kinematics and its controller.
        width: channels of the remainder's network.
    """

    weight: Tensor

    def __init__(self, arm: SerialArm, width: int = 128) -> None:
        super().__init__()
        self.kinematics = ArmKinematics(arm)
        count = arm.joints
        self.register_buffer("weight", torch.zeros(3 * count, count))
        self.net = nn.Sequential(
            nn.Linear(self.features, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, count),
        )
        nn.init.zeros_(self.net[-1].weight)  # type: ignore[arg-type]
        nn.init.zeros_(self.net[-1].bias)  # type: ignore[arg-type]

    @property
    def features(self) -> int:
        """Width of :meth:`describe`."""
        return 3 * (self.kinematics.arm.joints - 1) + 5 * self.kinematics.arm.joints + 5

    def observe(self, root: Tensor, joints: Tensor | None) -> Tensor:
        """Joint angles (..., 3, J) behind root poses (..., 3, 4, 4): as given, or by inverse kinematics from rest."""
        if joints is not None:
            return joints[..., : self.kinematics.arm.joints]
        found = []
        start = self.kinematics.rest.expand(*root.shape[:-3], -1)
        for k in range(3):
            start, _ = self.kinematics.solve(root[..., k, :, :], start, 20 if k == 0 else _ITERATIONS)
            found.append(start)
        return torch.stack(found, -2)

    @torch.no_grad()
    def command(self, joints: Tensor, action: Tensor) -> Tensor:
        """Way (B, J) from angles (B, J) to where the controller drives them: zero where it finds no solution."""
        goal = self.kinematics.target(joints, action)
        solution, miss = self.kinematics.solve(goal, joints, _ITERATIONS)
        found = torch.isfinite(solution).all(-1) & (miss < _UNSOLVED)
        return torch.where(found.unsqueeze(-1), solution - joints, 0.0)

    def describe(self, joints: Tensor, command: Tensor, root: Tensor) -> Tensor:
        """Features (B, K) of angles (B, 3, J), commands (B, J) and root poses (B, 4, 4); the same for a turned base."""
        angles = joints[:, 0, 1:]  # the first joint turns the whole arm about the vertical
        steps = joints[:, :2] - joints[:, 1:]
        height = root[:, 2, 3:] + root[:, 2, :3] @ self.kinematics.tool.unsqueeze(-1)  # of the tool
        parts = [
            angles,
            angles.sin(),
            angles.cos(),
            5.0 * command,
            torch.tanh(3.0 * command),
            torch.tanh(10.0 * command),
            20.0 * steps.flatten(1),
            torch.tanh(height / 0.02),
            torch.tanh(height / 0.1),
            root[:, 2, :3],
        ]
        return torch.cat(parts, 1)

    def linear(self, joints: Tensor, command: Tensor) -> Tensor:
        """Linear part (B, J) of the next step."""
        return self._regressors(joints, command) @ self.weight

    def forward(self, joints: Tensor, command: Tensor, root: Tensor) -> Tensor:
        """Next step (B, J) in radians of angles (B, 3, J) under commands (B, J), with the root link at (B, 4, 4)."""
        remainder = self.net(self.describe(joints, command, root)) * self.stirred(joints, command)
        return self.linear(joints, command) + _STEP * remainder

    @staticmethod
    def stirred(joints: Tensor, command: Tensor) -> Tensor:
        """0 (B, 1) where the arm rests without a command, near 1 elsewhere."""
        moves = torch.cat([command, (joints[:, :2] - joints[:, 1:]).flatten(1)], 1)
        size = moves.square().sum(-1, keepdim=True).clamp_min(1e-12).sqrt()
        return torch.tanh(30.0 * (size - _QUIET).clamp_min(0.0))

    def fit(self, joints: Tensor, action: Tensor, following: Tensor, steps: int) -> None:
        """Least squares, then gradient descent on the remainder.

        Args:
            joints: angles (B, 3, J) of transitions.
            action: (B, A).
            following: angles (B, J) after each.
            steps: optimiser steps.
        """
        joints, following = (x[..., : self.kinematics.arm.joints] for x in (joints, following))
        command = self.command(joints[:, 0], action)
        root = self.kinematics(joints[:, 0])
        moved = following - joints[:, 0]
        x = self._regressors(joints, command)
        self.weight.copy_(torch.linalg.lstsq(x.double(), moved.double(), driver="gelsd").solution.float())
        optimizer = torch.optim.AdamW(self.net.parameters(), _FIT_RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, steps))
        generator = torch.Generator().manual_seed(0)
        for _ in range(steps):
            index = torch.randint(len(moved), (_FIT_BATCH,), generator=generator)
            error = self(joints[index], command[index], root[index]) - moved[index]
            loss = F.huber_loss(error / 0.002, torch.zeros_like(error), delta=0.5)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            schedule.step()

    @staticmethod
    def _regressors(joints: Tensor, command: Tensor) -> Tensor:
        return torch.cat([command, (joints[:, :2] - joints[:, 1:]).flatten(1)], 1)
