"""How an arm's joints respond to actions: its controller's kinematics are known, its drives' dynamics are fitted.

The joints' next step is linear in their two last steps and in the way that is left to the controller's solution of
inverse kinematics, plus a small learned remainder (torque limits, inertia, gravity's load) that vanishes at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.robots import ArmKinematics, SerialArm

__all__ = ["STEP", "ArmOutlook", "ArmResponse"]

_UNSOLVED = 1e-3  # metres by which a solution may miss; ManiSkill's solver gives up there, and the arm stays
_ITERATIONS = 3
STEP = 0.01
"""Radians a step: the unit of what is learned."""
_QUIET = 1e-4  # radians: below it an arm is at rest
_FIT_BATCH, _FIT_RATE = 1024, 2e-3
_FIT_SCALE = 0.002  # radians that count as 1 in the fit's loss


@dataclass(frozen=True)
class ArmOutlook:
    """An arm's next step as fitted, and what a model needs to correct it."""

    step: Tensor
    """Of the joints (B, J), radians."""
    features: Tensor
    """What it follows from, and itself (B, K), of order 1; the same for a turned base."""
    stirred: Tensor
    """0 (B, 1) where the arm rests without a command, near 1 elsewhere."""


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
            nn.Linear(self.features - count, width),
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
        """Width of :attr:`ArmOutlook.features`."""
        return 9 * self.kinematics.arm.joints + 2

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

    def forward(self, joints: Tensor, action: Tensor, root: Tensor) -> ArmOutlook:
        """The next step of angles (B, 3, J) under actions (B, A), with the root link at (B, 4, 4)."""
        return self.respond(joints, self.command(joints[:, 0], action, root), root)

    @torch.no_grad()
    def command(self, joints: Tensor, action: Tensor, root: Tensor) -> Tensor:
        """Way (B, J) from angles (B, J) to where the controller drives them: zero where it finds no solution."""
        goal = self.kinematics.target(root, action)
        solution, miss = self.kinematics.solve(goal, joints, _ITERATIONS)
        found = torch.isfinite(solution).all(-1) & (miss < _UNSOLVED)
        return torch.where(found.unsqueeze(-1), solution - joints, 0.0)

    def respond(self, joints: Tensor, command: Tensor, root: Tensor) -> ArmOutlook:
        """The next step of angles (B, 3, J) under commands (B, J), with the root link at (B, 4, 4)."""
        moves = _moves(joints, command)
        angles = joints[:, 0, 1:]  # the first joint turns the whole arm about the vertical, which changes nothing
        height = root[:, 2, 3:] + root[:, 2, :3] @ self.kinematics.tool.unsqueeze(-1)  # of the tool
        parts = [
            angles,
            angles.sin(),
            angles.cos(),
            5.0 * command,
            torch.tanh(3.0 * command),
            torch.tanh(10.0 * command),
            20.0 * moves[:, command.shape[1] :],
            torch.tanh(height / 0.02),
            torch.tanh(height / 0.1),
            root[:, 2, :3],
        ]
        known = torch.cat(parts, 1)
        size = moves.square().sum(-1, keepdim=True).clamp_min(1e-12).sqrt()
        stirred = torch.tanh(30.0 * (size - _QUIET).clamp_min(0.0))
        step = moves @ self.weight + STEP * stirred * self.net(known)
        return ArmOutlook(step, torch.cat([known, step / STEP], 1), stirred)

    def fit(self, joints: Tensor, action: Tensor, following: Tensor, steps: int) -> None:
        """Least squares, then gradient descent on the remainder.

        Args:
            joints: angles (B, 3, J) of transitions.
            action: (B, A).
            following: angles (B, J) after each.
            steps: optimiser steps.
        """
        joints, following = (x[..., : self.kinematics.arm.joints] for x in (joints, following))
        root = self.kinematics(joints[:, 0])
        command = self.command(joints[:, 0], action, root)
        moved = following - joints[:, 0]
        moves = _moves(joints, command).double()
        self.weight.copy_(torch.linalg.lstsq(moves, moved.double(), driver="gelsd").solution.float())
        optimizer = torch.optim.AdamW(self.net.parameters(), _FIT_RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, steps))
        generator = torch.Generator().manual_seed(0)
        for _ in range(steps):
            index = torch.randint(len(moved), (_FIT_BATCH,), generator=generator)
            error = self.respond(joints[index], command[index], root[index]).step - moved[index]
            loss = F.huber_loss(error / _FIT_SCALE, torch.zeros_like(error), delta=0.5)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            schedule.step()


def _moves(joints: Tensor, command: Tensor) -> Tensor:
    """Commands (B, J) and the two last steps of angles (B, 3, J), side by side (B, 3 J)."""
    return torch.cat([command, (joints[:, :2] - joints[:, 1:]).flatten(1)], 1)
