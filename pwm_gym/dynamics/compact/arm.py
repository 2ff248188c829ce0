"""How an arm's joints respond to actions: its controller's kinematics are known, its drives' dynamics are fitted.

The joints' next positions and velocities are linear in their velocities and in the way that is left to the
controller's solution of inverse kinematics, plus a small learned remainder (inertia, torque limits) that vanishes at
rest.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pwm_gym.dynamics.compact.joint_response import ArmForecast, JointResponse
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Arm, ArmKinematics, Control

__all__ = ["ArmResponse"]

_UNSOLVED = 1e-3  # metres by which a solution may miss; ManiSkill's solver gives up there, and the arm stays
_ITERATIONS = 3
_SHORT = 0.01  # radians; a last step that is shorter leaves less than 0.1 mm
_SURE = 1e-4  # metres; what misses by more is solved for again, in small steps as ManiSkill's solver does
# Such steps, and their rate: of 5,316 hard commands in training data, 20 steps of 0.15 judge 0.4 % otherwise.
_CAREFUL = (6, 0.45)
_QUIET = 1e-4  # radians: below it an arm is at rest


class ArmResponse(JointResponse):
    """Joint steps under actions.

    Args:
        arm: the arm; its chain is known.
        control: its channels move the tool.
        width: channels of the remainder's network.

    Raises:
        PwmGymError: the arm has no chain, or no channel translates its tool.
    """

    def __init__(self, arm: Arm, control: Control, width: int = 128) -> None:
        move = control.channel(arm.name, "translation")
        if arm.chain is None or move is None:
            raise PwmGymError(f"arm {arm.name!r} has no known chain, or no channel that translates its tool")
        count = arm.chain.joints
        super().__init__(ArmKinematics(arm.chain), count, 2 * count, 7 * count + 2, width)
        self.arm, self._move, self._turn = arm, move, control.channel(arm.name, "rotation")
        self._yaw = control.channel(arm.name, "yaw")

    def observe(self, hand: Tensor) -> Tensor:
        """Joint positions and velocities (..., 2, J) behind hand poses (..., 3, 4, 4)."""
        rest = self.kinematics.rest.expand(*hand.shape[:-3], -1)
        now, _ = self.kinematics.solve(hand[..., 0, :, :], rest, 20)
        before, _ = self.kinematics.solve(hand[..., 1, :, :], now, _ITERATIONS)
        return torch.stack([now, self.braking * (now - before)], -2)

    def reach(self, hand: Tensor, joints: Tensor) -> Tensor:
        """Joint positions (B, J) at which the hand is at ``hand`` (B, 4, 4), not far from where ``joints`` bring it."""
        return self.kinematics.approach(hand, joints, 1)[0]

    def forward(self, joints: Tensor, action: Tensor, hand: Tensor, floor: float) -> ArmForecast:
        """The next step of joints (B, 2, J) under actions (B, A)."""
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
        return self._forecast(moves, known, motion_gate)

    def fit(self, joints: Tensor, action: Tensor, following: Tensor, steps: int, floor: float) -> None:
        """Least squares, then gradient descent on the remainder."""
        hand = self.kinematics(joints[:, 0])
        command = self.command(joints[:, 0], action, hand)
        moved = self._fit_linear(torch.cat([command, joints[:, 1]], 1), joints, following)
        self._descend(lambda rows: self.respond(joints[rows], command[rows], hand[rows], floor), moved, steps)
