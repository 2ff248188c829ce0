"""What the responses of arms share whose joints are known: a linear part, fitted, and a learned remainder.

A joint's next position and velocity are linear in what moves it, plus a small remainder that a network learns.
Velocities belong to the state: where commands change from step to step, past positions do not tell them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

__all__ = ["STEP", "ArmForecast", "JointResponse"]

STEP = 0.01
"""Radians (metres) a step: the unit of what is learned."""
_FIT_BATCH, _FIT_RATE = 1024, 2e-3
_FIT_SCALE = 0.002  # radians (metres) that count as 1 in the fit's loss


@dataclass(frozen=True)
class ArmForecast:
    """An arm's next step as fitted, and what a model needs to correct it."""

    step: Tensor
    """Change of the joints' positions, and their velocities after it (B, 2, J): radians (metres), and these a step."""
    features: Tensor
    """What the step follows from, and the step itself (B, K), of order 1; the same for a turned base."""
    motion_gate: Tensor
    """0 (B, 1) where the arm rests without a command, near 1 elsewhere."""


class JointResponse(nn.Module):
    """Joint steps under actions.

    Args:
        kinematics: hand poses (..., 4, 4) of joint positions (..., J), and ``limit``.
        joints: J.
        moves: numbers that the linear part follows from.
        known: numbers that the remainder follows from.
        width: channels of the remainder's network.
    """

    weight: Tensor
    braking: Tensor

    def __init__(self, kinematics: nn.Module, joints: int, moves: int, known: int, width: int) -> None:
        super().__init__()
        self.kinematics: Any = kinematics
        self.joints, self.features = joints, known + 2 * joints
        self.register_buffer("weight", torch.zeros(moves, 2 * joints))
        self.register_buffer("braking", torch.ones(()))  # velocity at a step's end over its average in the step
        self.net = nn.Sequential(
            nn.Linear(known, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, 2 * joints),
        )
        nn.init.zeros_(self.net[-1].weight)  # type: ignore[arg-type]
        nn.init.zeros_(self.net[-1].bias)  # type: ignore[arg-type]

    def observe(self, hand: Tensor) -> Tensor:
        """Joint positions and velocities (..., 2, J) behind hand poses (..., 3, 4, 4)."""
        raise NotImplementedError

    def forward(self, joints: Tensor, action: Tensor, hand: Tensor, floor: float) -> ArmForecast:
        """The next step of joints (B, 2, J) under actions (B, A).

        Args:
            joints: positions and velocities.
            action: in [-1, 1].
            hand: its pose (B, 4, 4).
            floor: height of what the hand may run into below, metres.
        """
        raise NotImplementedError

    def stop(self, velocity: Tensor, asked: Tensor, reached: Tensor) -> Tensor:
        """Velocities (B, J), a step, of joints at ``reached`` (B, J); without limits they were at ``asked`` (B, J)."""
        return velocity

    def reach(self, hand: Tensor, joints: Tensor) -> Tensor:
        """Joint positions (B, J) at which the hand is at ``hand`` (B, 4, 4), not far from where ``joints`` bring it."""
        raise NotImplementedError

    def fit(self, joints: Tensor, action: Tensor, following: Tensor, steps: int, floor: float) -> None:
        """Least squares, then gradient descent on the remainder.

        Args:
            joints: positions and velocities (B, 2, J) before transitions.
            action: (B, A).
            following: the same after each.
            steps: optimiser steps.
            floor: as of :meth:`forward`.
        """
        raise NotImplementedError

    def _forecast(self, moves: Tensor, known: Tensor, motion_gate: Tensor) -> ArmForecast:
        step = moves @ self.weight + STEP * motion_gate * self.net(known)
        return ArmForecast(step.unflatten(1, (2, -1)), torch.cat([known, step / STEP], 1), motion_gate)

    def _fit_linear(self, moves: Tensor, joints: Tensor, following: Tensor) -> Tensor:
        """Fit the linear part; returns the steps (B, 2, J) that the joints made."""
        moved = torch.stack([following[:, 0] - joints[:, 0], following[:, 1]], 1)
        self.braking.copy_((moved[:, 0] * moved[:, 1]).sum() / moved[:, 0].square().sum())
        target = moved.flatten(1).double()
        self.weight.copy_(torch.linalg.lstsq(moves.double(), target, driver="gelsd").solution.float())
        return moved

    def _descend(self, forecast: Callable[[Tensor], ArmForecast], moved: Tensor, steps: int) -> None:
        """Fit the remainder, so that ``forecast`` of rows (K,) of transitions gives what ``moved`` (B, 2, J) there."""
        optimizer = torch.optim.AdamW(self.net.parameters(), _FIT_RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, steps))
        generator = torch.Generator().manual_seed(0)
        for _ in range(steps):
            index = torch.randint(len(moved), (_FIT_BATCH,), generator=generator)
            error = forecast(index).step - moved[index]
            loss = F.huber_loss(error / _FIT_SCALE, torch.zeros_like(error), delta=0.5)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            schedule.step()
