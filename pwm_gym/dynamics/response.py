"""A robot's linear response to actions: a second-order autoregression with exogenous input (ARX).

A hand's next twist is linear in its two last twists and the action, with no constant: at rest and without a command
it rests. Where actions are targets of the joints behind it, it is linear in the hand's pose, too, and has a constant.
A driven joint's next speed is linear in the joints' positions, their two last speeds and the action.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Layout
from pwm_gym.scene.se3 import make_pose, motion_vector

__all__ = ["LinearResponse", "twist", "twists"]

_POSE = 7  # features: place, turn and a constant
_RIDGE = 1e-6  # of the mean squared feature: only to keep the normal equations solvable


def twist(before: Tensor, after: Tensor) -> Tensor:
    """World-frame twist (..., 6) from one pose (..., 4, 4) of an entity to the next: metres and radians."""
    turn = after[..., :3, :3] @ before[..., :3, :3].transpose(-1, -2)
    return torch.cat([after[..., :3, 3] - before[..., :3, 3], motion_vector(turn)], -1)


def twists(frames: Tensor) -> Tensor:
    """World-frame twists (..., 2, 6) at t and t-1 of one entity's poses (..., 3, 4, 4): metres and radians a step."""
    return twist(frames[..., 1:, :, :], frames[..., :2, :, :])


class LinearResponse(nn.Module):
    """Fitted response; :meth:`fit` is closed-form least squares over training transitions.

    Args:
        links: the robot's entities (:meth:`~pwm_gym.scene.Layout.robot`).
        action_size: A.
        targets: whether actions tell the joints behind a hand where to be.
    """

    hand_weight: Tensor
    hand_rest: Tensor
    joint_weight: Tensor
    reach: Tensor

    def __init__(self, links: Layout, action_size: int, targets: bool = False) -> None:
        super().__init__()
        self.hands = list(links.hands)
        self.tree = JointTree(links, [i for i, e in enumerate(links) if e.joint.moves], links.attached)
        joints, hands = len(self.tree), len(self.hands)
        self._targets = targets
        features = 12 + action_size
        if targets:
            features += _POSE
            self.register_buffer("hand_rest", torch.eye(4).repeat(hands, 1, 1))
        self.register_buffer("hand_weight", torch.zeros(hands, features, 6))
        self.register_buffer("joint_weight", torch.zeros(3 * joints + action_size + 1, joints))
        self.register_buffer("reach", torch.tensor([[torch.inf, -torch.inf, torch.inf]]).repeat(hands, 1))

    def hand_features(self, frames: Tensor, action: Tensor) -> Tensor:
        """(B, H, 12 + A): the hands' two last world-frame twists, and the action; of targets (B, H, 19 + A).

        Args:
            frames: poses (B, 3, L, 4, 4) of the links at t, t-1, t-2.
            action: (B, A).
        """
        moves = twists(frames[:, :, self.hands].transpose(1, 2)).flatten(-2)
        features = [moves, action.unsqueeze(1).expand(-1, len(self.hands), -1)]
        if self._targets:
            place = twist(self.hand_rest.to(frames), frames[:, 0, self.hands])
            features += [place, torch.ones_like(place[..., :1])]
        return torch.cat(features, -1)

    def joint_features(self, positions: Tensor, action: Tensor) -> Tensor:
        """(B, 3 S + A + 1): joint positions and two speeds of (B, 3, S), the action and a constant."""
        speeds = self.tree.between(positions[..., 1:, :], positions[..., :2, :])
        one = action.new_ones(*action.shape[:-1], 1)
        return torch.cat([positions[..., 0, :], speeds.flatten(-2), action, one], -1)

    def hand_twists(self, frames: Tensor, action: Tensor) -> Tensor:
        """World-frame twists (B, H, 6) of the hands' next step; arguments as of :meth:`hand_features`."""
        return torch.einsum("bhk,hkd->bhd", self.hand_features(frames, action), self.hand_weight)

    def joint_step(self, positions: Tensor, action: Tensor) -> Tensor:
        """Speeds (B, S) of the next step at joint positions (B, 3, S) under actions (B, A)."""
        return self.joint_features(positions, action) @ self.joint_weight

    def confine(self, position: Tensor) -> Tensor:
        """Hands' positions (B, H, 3) within reach: distance from the base's axis and height, as ever observed."""
        farthest, lowest, highest = self.reach.unbind(-1)
        radius = position[..., :2].norm(dim=-1).clamp_min(1e-6)
        flat = position[..., :2] * (torch.minimum(radius, farthest) / radius).unsqueeze(-1)
        height = torch.minimum(torch.maximum(position[..., 2], lowest), highest)
        return torch.cat([flat, height.unsqueeze(-1)], -1)

    @torch.no_grad()
    def fit(self, frames: Tensor, action: Tensor, following: Tensor) -> None:
        """Least squares over transitions.

        Args:
            frames: poses (B, 3, L, 4, 4) of the links.
            action: (B, A).
            following: their next poses (B, L, 4, 4).
        """
        after = torch.cat([following.unsqueeze(1), frames[:, :2]], 1)
        if self.hands:
            position = following[:, self.hands][..., :3, 3]
            radius, height = position[..., :2].norm(dim=-1), position[..., 2]
            self.reach.copy_(torch.stack([radius.amax(0), height.amin(0), height.amax(0)], -1))
            if self._targets:
                self.hand_rest.copy_(_middle(following[:, self.hands]))
            target = twists(after[:, :, self.hands].transpose(1, 2))[:, :, 0]
            features = self.hand_features(frames, action)
            weights = [_least_squares(features[:, h], target[:, h]) for h in range(len(self.hands))]
            self.hand_weight.copy_(torch.stack(weights))
        if len(self.tree):
            positions = self.tree.positions(frames)
            speeds = self.tree.between(positions[:, 0], self.tree.positions(following))
            self.joint_weight.copy_(_least_squares(self.joint_features(positions, action), speeds))


def _middle(poses: Tensor) -> Tensor:
    """Mean poses (H, 4, 4) of poses (B, H, 4, 4)."""
    u, _, v = torch.linalg.svd(poses[..., :3, :3].mean(0))
    u = torch.cat([u[..., :2], u[..., 2:] * torch.linalg.det(u @ v)[..., None, None]], -1)
    return make_pose(u @ v, poses[..., :3, 3].mean(0))


def _least_squares(features: Tensor, target: Tensor) -> Tensor:
    x, y = features.double(), target.double()
    gram = x.T @ x
    ridge = _RIDGE * gram.diagonal().clamp_min(1e-12)
    return torch.linalg.solve(gram + torch.diag(ridge), x.T @ y).float()
