"""How an arm's joints respond to actions: its controller's kinematics are known, its drives' dynamics are fitted.

The joints' next positions and velocities are linear in their velocities and in the way that is left to the
controller's solution of inverse kinematics, plus a small learned remainder (inertia, torque limits) that vanishes at
rest. Velocities belong to the state: where commands change from step to step, past positions do not tell them.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Arm, ArmKinematics, Control

__all__ = ["STEP", "ArmForecast", "ArmResponse"]

_UNSOLVED = 1e-3  # metres by which a solution may miss; ManiSkill's solver gives up there, and the arm stays
_ITERATIONS = 3
_SHORT = 0.01  # radians; a last step that is shorter leaves less than 0.1 mm
_SURE = 1e-4  # metres; what misses by more is solved for again, in small steps as ManiSkill's solver does
# Such steps, and their rate: of 5,316 hard commands in training data, 20 steps of 0.15 judge 0.4 % otherwise.
_CAREFUL = (6, 0.45)
STEP = 0.01
"""Radians a step: the unit of what is learned."""
_QUIET = 1e-4  # radians: below it an arm is at rest
_FIT_BATCH, _FIT_RATE = 1024, 2e-3
_FIT_SCALE = 0.002  # radians that count as 1 in the fit's loss


@dataclass(frozen=True)
class ArmForecast:
    """An arm's next step as fitted, and what a model needs to correct it."""

    step: Tensor
    """Change of the joints' positions, and their velocities after it (B, 2, J): radians, radians a step."""
    features: Tensor
    """What the step follows from, and the step itself (B, K), of order 1; the same for a turned base."""
    motion_gate: Tensor
    """0 (B, 1) where the arm rests without a command, near 1 elsewhere."""


class ArmResponse(nn.Module):
    """Joint steps under actions.

    Args:
        arm: the arm; its chain is known.
        control: its channels move the tool.
        width: channels of the remainder's network.

    Raises:
        PwmGymError: the arm has no chain, or no channel translates its tool.
    """

    weight: Tensor
    braking: Tensor

    def __init__(self, arm: Arm, control: Control, width: int = 128) -> None:
        super().__init__()
        move = control.channel(arm.name, "translation")
        if arm.chain is None or move is None:
            raise PwmGymError(f"arm {arm.name!r} has no known chain, or no channel that translates its tool")
        self.arm, self._move, self._turn = arm, move, control.channel(arm.name, "rotation")
        self._yaw = control.channel(arm.name, "yaw")
        self.kinematics = ArmKinematics(arm.chain)
        count = arm.chain.joints
        self.register_buffer("weight", torch.zeros(2 * count, 2 * count))
        self.register_buffer("braking", torch.ones(()))  # velocity at a step's end over its average in the step
        self.net = nn.Sequential(
            nn.Linear(self.features - 2 * count, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, 2 * count),
        )
        nn.init.zeros_(self.net[-1].weight)  # type: ignore[arg-type]
        nn.init.zeros_(self.net[-1].bias)  # type: ignore[arg-type]

    @property
    def features(self) -> int:
        """Width of :attr:`ArmForecast.features`."""
        return 9 * self.kinematics.arm.joints + 2

    def observe(self, hand: Tensor) -> Tensor:
        """Joint positions and velocities (..., 2, J) behind hand poses (..., 3, 4, 4)."""
        rest = self.kinematics.rest.expand(*hand.shape[:-3], -1)
        now, _ = self.kinematics.solve(hand[..., 0, :, :], rest, 20)
        before, _ = self.kinematics.solve(hand[..., 1, :, :], now, _ITERATIONS)
        return torch.stack([now, self.braking * (now - before)], -2)

    def forward(self, joints: Tensor, action: Tensor, hand: Tensor, floor: float) -> ArmForecast:
        """The next step of joints (B, 2, J) under actions (B, A).

        Args:
            joints: positions and velocities.
            action: in [-1, 1].
            hand: its pose (B, 4, 4).
            floor: height of what the hand may run into below, metres.
        """
        return self.respond(joints, self.command(joints[:, 0], action, hand), hand, floor)

    def command(self, joints: Tensor, action: Tensor, hand: Tensor) -> Tensor:
        """Way (B, J) from angles (B, J) to where the controller drives them: zero where it finds no solution.

        Where actions ask for a gradient, it is that of one more step of inverse kinematics at the solution.
        """
        with torch.no_grad():
            solution, found = self._solution(self._target(hand, action), joints)
        if action.requires_grad:
            further, _, _ = self.kinematics.approach(self._target(hand, action), solution, 1)
            solution = solution + further - further.detach()
        else:
            joints = joints.detach()
        return torch.where(found.unsqueeze(-1), solution - joints, 0.0)

    def _target(self, hand: Tensor, action: Tensor) -> Tensor:
        translation, angles = self._move.unit * action[..., self._move.slice], None
        if self._turn is not None:
            units = action[..., self._turn.slice]
            angles = self._turn.unit * units / units.norm(dim=-1, keepdim=True).clamp_min(1.0)
        yaw = None if self._yaw is None else self._yaw.unit * action[..., self._yaw.slice]
        return self.kinematics.target(hand, translation, angles, yaw)

    def _solution(self, goal: Tensor, joints: Tensor) -> tuple[Tensor, Tensor]:
        """Angles (B, J) near ``joints`` at which the hand is at ``goal`` (B, 4, 4), and whether there are any."""
        solution, before, last = self.kinematics.approach(goal, joints, _ITERATIONS)
        found = (before < _UNSOLVED) & (last < _SHORT)
        doubtful = (~found).nonzero().squeeze(1)
        if len(doubtful):
            solution[doubtful], found[doubtful] = self._verified(goal[doubtful], joints[doubtful], solution[doubtful])
        return solution, found

    def _verified(self, goal: Tensor, joints: Tensor, solution: Tensor) -> tuple[Tensor, Tensor]:
        """Solutions (B, J), sought anew in small steps where they miss the goal, and whether each reaches it."""
        _, miss = self.kinematics.solve(goal, solution, 0)
        hard = ~(miss < _SURE)  # near the edge of the reach, where whole steps overshoot
        if hard.any():
            close, _, _ = self.kinematics.approach(goal[hard], joints[hard], *_CAREFUL)
            solution[hard], miss[hard] = self.kinematics.solve(goal[hard], close, _ITERATIONS)
        return solution, torch.isfinite(solution).all(-1) & (miss < _UNSOLVED)

    def respond(self, joints: Tensor, command: Tensor, hand: Tensor, floor: float) -> ArmForecast:
        """As :meth:`forward`, under commands (B, J) of :meth:`command`."""
        moves = torch.cat([command, joints[:, 1]], 1)
        angles = joints[:, 0, 1:]  # the first joint turns the whole arm about the vertical, which changes nothing
        height = hand[:, 2, 3:] + hand[:, 2, :3] @ self.kinematics.tool.unsqueeze(-1) - floor  # of the tool
        parts = [
            angles,
            angles.sin(),
            angles.cos(),
            5.0 * command,
            torch.tanh(3.0 * command),
            torch.tanh(10.0 * command),
            20.0 * joints[:, 1],
            torch.tanh(height / 0.02),
            torch.tanh(height / 0.1),
            hand[:, 2, :3],
        ]
        known = torch.cat(parts, 1)
        size = moves.square().sum(-1, keepdim=True).clamp_min(1e-12).sqrt()
        motion_gate = torch.tanh(30.0 * (size - _QUIET).clamp_min(0.0))
        step = moves @ self.weight + STEP * motion_gate * self.net(known)
        return ArmForecast(step.unflatten(1, (2, -1)), torch.cat([known, step / STEP], 1), motion_gate)

    def fit(self, joints: Tensor, action: Tensor, following: Tensor, steps: int, floor: float) -> None:
        """Least squares, then gradient descent on the remainder.

        Args:
            joints: positions and velocities (B, 2, J) before transitions.
            action: (B, A).
            following: the same after each.
            steps: optimiser steps.
            floor: as of :meth:`forward`.
        """
        hand = self.kinematics(joints[:, 0])
        command = self.command(joints[:, 0], action, hand)
        moved = torch.stack([following[:, 0] - joints[:, 0], following[:, 1]], 1)
        self.braking.copy_((moved[:, 0] * moved[:, 1]).sum() / moved[:, 0].square().sum())
        moves = torch.cat([command, joints[:, 1]], 1).double()
        solution = torch.linalg.lstsq(moves, moved.flatten(1).double(), driver="gelsd").solution
        self.weight.copy_(solution.float())
        optimizer = torch.optim.AdamW(self.net.parameters(), _FIT_RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, steps))
        generator = torch.Generator().manual_seed(0)
        for _ in range(steps):
            index = torch.randint(len(moved), (_FIT_BATCH,), generator=generator)
            error = self.respond(joints[index], command[index], hand[index], floor).step - moved[index]
            loss = F.huber_loss(error / _FIT_SCALE, torch.zeros_like(error), delta=0.5)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            schedule.step()
