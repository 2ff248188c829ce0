"""How a gantry's joints respond to actions that tell each of them where to be.

Their next positions and velocities are linear in targets, positions and velocities, with a constant, plus a small
learned remainder. A joint with a target never rests for want of a command, and its errors do not add up.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pwm_gym.dynamics.compact.joint_response import ArmForecast, JointResponse
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Arm, Control, GantryKinematics

__all__ = ["GantryResponse"]


class GantryResponse(JointResponse):
    """Joint steps under targets.

    Args:
        arm: the arm; its gantry is known.
        control: its channel of joints has a target for each.
        width: channels of the remainder's network.

    Raises:
        PwmGymError: the arm has no gantry, or no channel of as many joints.
    """

    def __init__(self, arm: Arm, control: Control, width: int = 128) -> None:
        targets = control.channel(arm.name, "joint")
        if arm.gantry is None or targets is None or targets.stop - targets.start != arm.gantry.joints:
            raise PwmGymError(f"arm {arm.name!r} is no known gantry, or no channel has a target for each of its joints")
        count = arm.gantry.joints
        super().__init__(GantryKinematics(arm.gantry), count, 3 * count + 1, 3 * count + 5, width)
        self.arm, self._targets = arm, targets

    def observe(self, hand: Tensor) -> Tensor:
        """Joint positions and velocities (..., 2, J) behind hand poses (..., 3, 4, 4)."""
        now, before = (self.kinematics.solve(hand[..., k, :, :]) for k in (0, 1))
        return torch.stack([now, self.braking * (now - before)], -2)

    def stop(self, velocity: Tensor, asked: Tensor, reached: Tensor) -> Tensor:
        """Velocities (B, J), a step: none of joints that run into their limits."""
        return velocity.where(asked == reached, 0.0)

    def reach(self, hand: Tensor, joints: Tensor) -> Tensor:
        """Joint positions (B, J) at which the hand is at ``hand`` (B, 4, 4)."""
        return self.kinematics.solve(hand)

    def forward(self, joints: Tensor, action: Tensor, hand: Tensor, floor: float) -> ArmForecast:
        """The next step of joints (B, 2, J) under actions (B, A)."""
        position, velocity = joints.unbind(1)
        height = hand[:, 2, 3:] - floor
        parts = [
            action[:, self._targets.slice],
            position,
            20.0 * velocity,
            torch.tanh(height / 0.02),
            torch.tanh(height / 0.1),
            hand[:, 2, :3],
        ]
        always = joints.new_ones(len(joints), 1)  # a target asks for motion wherever the joint is not there yet
        return self._forecast(self._moves(joints, action), torch.cat(parts, 1), always)

    def _moves(self, joints: Tensor, action: Tensor) -> Tensor:
        """What the linear part follows from (B, 3 J + 1): targets, positions, velocities and a constant."""
        return torch.cat([action[:, self._targets.slice], *joints.unbind(1), joints.new_ones(len(joints), 1)], 1)

    def fit(self, joints: Tensor, action: Tensor, following: Tensor, steps: int, floor: float) -> None:
        """Least squares, then gradient descent on the remainder."""
        hand = self.kinematics(joints[:, 0])
        moved = self._fit_linear(self._moves(joints, action), joints, following)
        self._descend(lambda rows: self(joints[rows], action[rows], hand[rows], floor), moved, steps)
