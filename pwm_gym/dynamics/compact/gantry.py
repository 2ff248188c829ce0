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
from pwm_gym.robots.gantry import SOFT

__all__ = ["GantryResponse"]


class GantryResponse(JointResponse):
    """Joint steps under targets: of the gantry, and of the links on its hand that have targets, too.

    They are one response: what bends the fingers swings the forearm.

    Args:
        arm: the arm; its gantry is known.
        control: its channels of joints and fingers have a target for each.
        width: channels of the remainder's network.
        limits: lowest and highest positions (2, K) of the joints of ``arm.links``; None where it has none.

    Raises:
        PwmGymError: the arm has no gantry, or actions have no target for each joint.
    """

    lower: Tensor
    upper: Tensor

    def __init__(self, arm: Arm, control: Control, width: int = 128, limits: Tensor | None = None) -> None:
        targets = _targets(arm, control)
        count = arm.joints.stop - arm.joints.start
        if arm.gantry is None or len(targets) != count:
            raise PwmGymError(f"arm {arm.name!r} is no known gantry, or no channel has a target for each of its joints")
        super().__init__(GantryKinematics(arm.gantry), count, 3 * count + 1, 3 * count + 5, width)
        self.arm, self.own, self._targets = arm, arm.gantry.joints, targets
        lower, upper = torch.zeros(2, len(arm.links)) if limits is None else limits
        soft = SOFT * (upper - lower)
        self.register_buffer("lower", lower - soft, persistent=False)
        self.register_buffer("upper", upper + soft, persistent=False)

    def observe(self, hand: Tensor, links: Tensor) -> Tensor:
        """Joint positions and velocities (..., 2, J) behind hand poses (..., 3, 4, 4) and links at (..., 3, K)."""
        own = self.kinematics.solve(hand)
        now, before = torch.cat([own, links], -1)[..., :2, :].unbind(-2)
        return torch.stack([now, self.braking * (now - before)], -2)

    def hand(self, joints: Tensor) -> Tensor:
        """The hand's pose (..., 4, 4) at joint positions (..., J)."""
        return self.kinematics(joints[..., : self.own])  # type: ignore[no-any-return]

    def limit(self, joints: Tensor) -> Tensor:
        """Joint positions (..., J) within what their springs allow."""
        links = torch.minimum(torch.maximum(joints[..., self.own :], self.lower), self.upper)
        return torch.cat([self.kinematics.limit(joints[..., : self.own]), links], -1)

    def reach(self, hand: Tensor, joints: Tensor) -> Tensor:
        """Joint positions (B, J) at which the hand is at ``hand`` (B, 4, 4); links stay at those of ``joints``."""
        return torch.cat([self.kinematics.solve(hand), joints[..., self.own :]], -1)

    def forward(self, joints: Tensor, action: Tensor, hand: Tensor, floor: float) -> ArmForecast:
        """The next step of joints (B, 2, J) under actions (B, A)."""
        position, velocity = joints.unbind(1)
        height = hand[:, 2, 3:] - floor
        parts = [
            action[:, self._targets],
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
        return torch.cat([action[:, self._targets], *joints.unbind(1), joints.new_ones(len(joints), 1)], 1)

    def fit(self, joints: Tensor, action: Tensor, following: Tensor, steps: int, floor: float) -> None:
        """Least squares, then gradient descent on the remainder."""
        hand = self.hand(joints[:, 0])
        moved = self._fit_linear(self._moves(joints, action), joints, following)
        self._descend(lambda rows: self(joints[rows], action[rows], hand[rows], floor), moved, steps)


def _targets(arm: Arm, control: Control) -> list[int]:
    """Components of an action that are targets of the arm's joints: of its links, too, where it has some."""
    own = control.channel(arm.name, "joint")
    channels = control.of_kind("joint", "finger") if arm.links else (() if own is None else (own,))
    return [k for c in channels for k in range(c.start, c.stop)]
