"""The end effector's linear response to actions: a second-order autoregression with exogenous input (ARX).

The root link's next twist is linear in its two last twists and the action, with no constant: at rest and without a
command it rests. A sliding link's next opening speed is linear in the openings, their two last speeds and the action.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pwm_gym.scene import Layout
from pwm_gym.scene.se3 import matrix_from_pose7, motion_vector

__all__ = ["EndEffector", "LinearResponse", "twist", "twists"]

_RIDGE = 1e-6  # of the mean squared feature: only to keep the normal equations solvable


def twist(before: Tensor, after: Tensor) -> Tensor:
    """World-frame twist (..., 6) from one pose (..., 4, 4) of an entity to the next: metres and radians."""
    turn = after[..., :3, :3] @ before[..., :3, :3].transpose(-1, -2)
    return torch.cat([after[..., :3, 3] - before[..., :3, 3], motion_vector(turn)], -1)


def twists(frames: Tensor) -> Tensor:
    """World-frame twists (..., 2, 6) at t and t-1 of one entity's poses (..., 3, 4, 4): metres and radians a step."""
    return twist(frames[..., 1:, :, :], frames[..., :2, :, :])


class EndEffector(nn.Module):
    """Kinematics of the effector links of a layout: one root, and links that slide on it."""

    origins: Tensor
    directions: Tensor
    along: Tensor

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self.root = layout.hands[0]
        self.sliding = [i for i in layout.driven if layout.entities[i].joint.moves]
        sliders = [layout.entities[i].joint for i in self.sliding]
        origins = matrix_from_pose7(torch.tensor([s.origin for s in sliders]).reshape(-1, 7))
        axes = torch.tensor([s.axis for s in sliders]).reshape(-1, 3, 1)
        self.register_buffer("origins", origins, persistent=False)  # (S, 4, 4)
        # Directions (S, 3) in which the links open in the root's frame, and how far they are along them when shut (S,).
        self.register_buffer("directions", (origins[:, :3, :3] @ axes).squeeze(-1), persistent=False)
        self.register_buffer("along", (self.origins[:, :3, 3] * self.directions).sum(-1), persistent=False)  # (S,)
        self.uppers = [s.upper for s in sliders]

    def openings(self, frames: Tensor) -> Tensor:
        """Openings (..., 3, S) in metres of poses (..., 3, E, 4, 4) at t, t-1, t-2."""
        root = frames[..., self.root, None, :, :]
        links = frames[..., self.sliding, :, :]
        offset = (links[..., :3, 3] - root[..., :3, 3]).unsqueeze(-2) @ root[..., :3, :3]  # (..., 3, S, 1, 3)
        return (offset.squeeze(-2) * self.directions).sum(-1) - self.along

    def links(self, root: Tensor, openings: Tensor) -> Tensor:
        """Poses (..., S, 4, 4) of the sliding links at root poses (..., 4, 4) and openings (..., S) in metres."""
        local = self.origins.expand(*openings.shape, 4, 4).clone()
        local[..., :3, 3] = self.origins[:, :3, 3] + self.directions * openings.unsqueeze(-1)
        return root.unsqueeze(-3) @ local

    def limit(self, openings: Tensor) -> Tensor:
        """Openings (..., S) within the joints' limits."""
        upper = openings.new_tensor(self.uppers)
        return torch.minimum(openings.clamp_min(0.0), upper)


class LinearResponse(nn.Module):
    """Fitted response; :meth:`fit` is closed-form least squares over training transitions."""

    root_weight: Tensor
    slide_weight: Tensor
    reach: Tensor

    def __init__(self, layout: Layout, action_size: int) -> None:
        super().__init__()
        self.effector = EndEffector(layout)
        sliders = len(self.effector.sliding)
        self.register_buffer("root_weight", torch.zeros(12 + action_size, 6))
        self.register_buffer("slide_weight", torch.zeros(3 * sliders + action_size + 1, sliders))
        self.register_buffer("reach", torch.tensor([torch.inf, -torch.inf, torch.inf]))

    def root_features(self, frames: Tensor, action: Tensor) -> Tensor:
        """(B, 12 + A): two world-frame twists of the root link and the action."""
        return torch.cat([twists(frames[..., self.effector.root, :, :]).flatten(-2), action], -1)

    def slide_features(self, openings: Tensor, action: Tensor) -> Tensor:
        """(B, 3 S + A + 1): openings and two speeds of openings (B, 3, S), the action and a constant."""
        speeds = openings[..., :2, :] - openings[..., 1:, :]
        one = torch.ones_like(action[..., :1])
        return torch.cat([openings[..., 0, :], speeds.flatten(-2), action, one], -1)

    def forward(self, frames: Tensor, openings: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Root twist (B, 6) in the world frame and opening speeds (B, S) of the next step."""
        return self.root_features(frames, action) @ self.root_weight, self.slide(openings, action)

    def slide(self, openings: Tensor, action: Tensor) -> Tensor:
        """Opening speeds (B, S) of the next step at openings (B, 3, S) under actions (B, A), metres a step."""
        return self.slide_features(openings, action) @ self.slide_weight

    def confine(self, position: Tensor) -> Tensor:
        """Root position (B, 3) within the arm's reach: distance from the base's axis and height, as ever observed."""
        farthest, lowest, highest = self.reach
        radius = position[:, :2].norm(dim=-1, keepdim=True).clamp_min(1e-6)
        flat = position[:, :2] * (torch.minimum(radius, farthest) / radius)
        return torch.cat([flat, torch.clamp(position[:, 2:], lowest, highest)], -1)

    @torch.no_grad()
    def fit(self, frames: Tensor, action: Tensor, following: Tensor) -> None:
        """Least squares over transitions: poses (B, 3, E, 4, 4), actions (B, A), next poses (B, E, 4, 4)."""
        position = following[:, self.effector.root, :3, 3]
        radius, height = position[:, :2].norm(dim=-1), position[:, 2]
        self.reach.copy_(torch.stack([radius.max(), height.min(), height.max()]))
        after = torch.cat([following.unsqueeze(1), frames[:, :2]], 1)
        openings = self.effector.openings(frames)
        speeds = self.effector.openings(after)[:, 0] - openings[:, 0]
        target = twists(after[:, :, self.effector.root])[:, 0]
        self.root_weight.copy_(_least_squares(self.root_features(frames, action), target))
        self.slide_weight.copy_(_least_squares(self.slide_features(openings, action), speeds))


def _least_squares(features: Tensor, target: Tensor) -> Tensor:
    x, y = features.double(), target.double()
    gram = x.T @ x
    ridge = _RIDGE * gram.diagonal().clamp_min(1e-12)
    return torch.linalg.solve(gram + torch.diag(ridge), x.T @ y).float()
