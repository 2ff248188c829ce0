"""How a gantry's joints respond to actions that tell each of them where to be.

Their next positions and velocities are linear in targets, positions and velocities, with a constant, plus a small
learned remainder. A joint with a target never rests for want of a command, and its errors do not add up.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from pwm_gym.dynamics.compact.joint_response import ArmForecast, JointResponse, Servo
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Arm, Control, GantryKinematics
from pwm_gym.robots.gantry import SOFT

__all__ = ["GantryResponse", "LinkResponse"]

_FASTER = 1.2  # than the fastest that was observed, links may be
_STOP = 0.02  # metres and radians, within which a joint's limit stops it
_FAST = 20.0  # by which velocities are multiplied to be of order 1


class LinkResponse(Servo):
    """Steps of the joints of links that hang on a hand, under targets of their own.

    Args:
        limits: lowest and highest positions (2, K) of the joints.
        width: channels of the remainder's network.
    """

    lower: Tensor
    upper: Tensor
    fastest: Tensor

    def __init__(self, limits: Tensor, width: int) -> None:
        count = limits.shape[1]
        super().__init__(count, 3 * count + 1, 5 * count, width)
        self.register_buffer("fastest", torch.full((count,), torch.inf))  # steps, as ever observed
        self.register_buffer("lower", limits[0], persistent=False)
        self.register_buffer("upper", limits[1], persistent=False)

    def forward(self, joints: Tensor, targets: Tensor) -> Tensor:
        """Steps and next velocities (B, 2, K) of joints (B, 2, K) under targets (B, K)."""
        state = joints.detach()  # far rollouts' gradients would grow from step to step, and drown all others
        known = torch.cat([targets, state[:, 0], _FAST * state[:, 1], *_stops(state, self.lower, self.upper)], 1)
        always = joints.new_ones(len(joints), 1)
        return self._steps(_moves(joints, targets), known, always).unflatten(1, (2, -1))

    def limit(self, joints: Tensor) -> Tensor:
        """Joint positions (..., K) within what their springs allow."""
        soft = SOFT * (self.upper - self.lower)
        return torch.minimum(torch.maximum(joints, self.lower - soft), self.upper + soft)

    def slow(self, steps: Tensor) -> Tensor:
        """Steps and next velocities (..., K) hardly faster than ever observed."""
        return torch.minimum(torch.maximum(steps, -self.fastest), self.fastest)

    def fit(self, joints: Tensor, targets: Tensor, following: Tensor, steps: int) -> None:
        """Least squares, then gradient descent on the remainder; joints (B, 2, K) before and after transitions."""
        moved = self._fit_linear(_moves(joints, targets), joints, following)
        self.fastest.copy_(_FASTER * moved.abs().amax((0, 1)))
        self._descend(lambda rows: self(joints[rows], targets[rows]).flatten(1), moved, steps)


class GantryResponse(JointResponse):
    """Joint steps under targets: of the gantry, and of the links on its hand that have targets, too.

    With links the remainder is told how near joints are to their limits; without, it finds out by itself.

    Args:
        arm: the arm; its gantry is known.
        control: its channels of joints and fingers have a target for each.
        width: channels of the remainders' networks.
        limits: lowest and highest positions (2, K) of the joints of ``arm.links``; None where it has none.

    Raises:
        PwmGymError: the arm has no gantry, or actions have no target for each joint.
    """

    lower: Tensor
    upper: Tensor

    def __init__(self, arm: Arm, control: Control, width: int = 128, limits: Tensor | None = None) -> None:
        targets = _targets(arm, control)
        if arm.gantry is None or len(targets) != arm.joints.stop - arm.joints.start:
            raise PwmGymError(f"arm {arm.name!r} is no known gantry, or no channel has a target for each of its joints")
        own = arm.gantry.joints
        known = 5 * own + 5 if arm.links else 3 * own + 5
        super().__init__(GantryKinematics(arm.gantry), own, 3 * own + 1, known, width)
        self.register_buffer("lower", torch.tensor(arm.gantry.lower), persistent=False)
        self.register_buffer("upper", torch.tensor(arm.gantry.upper), persistent=False)
        self.arm, self.own, self._targets = arm, own, targets
        self.joints = len(targets)
        self.links = LinkResponse(limits, width) if limits is not None and limits.numel() else None

    def observe(self, hand: Tensor, links: Tensor) -> Tensor:
        """Joint positions and velocities (..., 2, J) behind hand poses (..., 3, 4, 4) and links at (..., 3, K)."""
        own = self.kinematics.solve(hand)
        found = torch.stack([own[..., 0, :], self.braking * (own[..., 0, :] - own[..., 1, :])], -2)
        if self.links is None:
            return found
        speeds = self.links.braking * (links[..., 0, :] - links[..., 1, :])
        return torch.cat([found, torch.stack([links[..., 0, :], speeds], -2)], -1)

    def hand(self, joints: Tensor) -> Tensor:
        """The hand's pose (..., 4, 4) at joint positions (..., J)."""
        return self.kinematics(joints[..., : self.own])

    def limit(self, joints: Tensor) -> Tensor:
        """Joint positions (..., J) within what their springs allow."""
        own = self.kinematics.limit(joints[..., : self.own])
        return own if self.links is None else torch.cat([own, self.links.limit(joints[..., self.own :])], -1)

    def slow(self, steps: Tensor) -> Tensor:
        """Steps and next velocities (..., J), those of links hardly faster than ever observed.

        Positions have limits, velocities have none: a rollout that leaves what was observed would go ever faster.
        """
        if self.links is None:
            return steps
        return torch.cat([steps[..., : self.own], self.links.slow(steps[..., self.own :])], -1)

    def reach(self, hand: Tensor, joints: Tensor) -> Tensor:
        """Joint positions (B, J) at which the hand is at ``hand`` (B, 4, 4); links stay at those of ``joints``."""
        return torch.cat([self.kinematics.solve(hand), joints[..., self.own :]], -1)

    def forward(self, joints: Tensor, action: Tensor, hand: Tensor, floor: float) -> ArmForecast:
        """The next step of joints (B, 2, J) under actions (B, A)."""
        targets = action[:, self._targets]
        forecast = self._gantry(joints[..., : self.own], targets[:, : self.own], hand, floor)
        if self.links is None:
            return forecast
        step = self.links(joints[..., self.own :], targets[:, self.own :])
        return replace(forecast, step=torch.cat([forecast.step, step], 2))

    def _gantry(self, joints: Tensor, targets: Tensor, hand: Tensor, floor: float) -> ArmForecast:
        """The next step of the gantry's joints (B, 2, J')."""
        position, velocity = joints.unbind(1)
        height = hand[:, 2, 3:] - floor
        parts = [
            targets,
            position,
            _FAST * velocity,
            *(_stops(joints.detach(), self.lower, self.upper) if self.links is not None else ()),
            torch.tanh(height / 0.02),
            torch.tanh(height / 0.1),
            hand[:, 2, :3],
        ]
        always = joints.new_ones(len(joints), 1)  # a target asks for motion wherever the joint is not there yet
        return self._forecast(_moves(joints, targets), torch.cat(parts, 1), always)

    def fit(self, joints: Tensor, action: Tensor, following: Tensor, steps: int, floor: float) -> None:
        """Least squares, then gradient descent on the remainders."""
        targets = action[:, self._targets]
        own, goals, after = joints[..., : self.own], targets[:, : self.own], following[..., : self.own]
        hand = self.hand(joints[:, 0])
        moved = self._fit_linear(_moves(own, goals), own, after)
        self._descend(
            lambda rows: self._gantry(own[rows], goals[rows], hand[rows], floor).step.flatten(1), moved, steps
        )
        if self.links is not None:
            self.links.fit(joints[..., self.own :], targets[:, self.own :], following[..., self.own :], steps)


def _stops(joints: Tensor, lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor]:
    """How far past its limits (J,) each joint of (B, 2, J) would be one step later, (B, J) each, in (-1, 1)."""
    ahead = joints[:, 0] + joints[:, 1]
    return torch.tanh((lower - ahead) / _STOP), torch.tanh((ahead - upper) / _STOP)


def _moves(joints: Tensor, targets: Tensor) -> Tensor:
    """What linear parts follow from (B, 3 J + 1): targets, positions, velocities and a constant."""
    return torch.cat([targets, *joints.unbind(1), joints.new_ones(len(joints), 1)], 1)


def _targets(arm: Arm, control: Control) -> list[int]:
    """Components of an action that are targets of the arm's joints: of its links, too, where it has some."""
    own = control.channel(arm.name, "joint")
    channels = control.of_kind("joint", "finger") if arm.links else (() if own is None else (own,))
    return [k for c in channels for k in range(c.start, c.stop)]
