"""What the contacts of an object depend on, point by point: its motion, the table, the end effector's boxes.

An object's points are carried on by their own velocities for one step, and the end effector's links by what is known
of theirs; where the points then lie above the table and outside or inside the links' bounding boxes says who is about
to hit whom. A small network reads it, and the largest and mean of its outputs tell the entity's token.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.response import EndEffector
from pwm_gym.scene import Layout, RigidState
from pwm_gym.scene.se3 import transform

__all__ = ["FALL", "ContactFeatures"]

FALL = -9.81 * 0.05**2
"""Metres by which free fall changes a step from one to the next: gravity times the control step squared."""

_LENGTH, _NEAR, _TOUCH, _STEP = 0.1, 0.01, 0.005, 0.01  # metres that count as 1


class ContactFeatures(nn.Module):
    """Contact features of entities that the robot does not drive.

    Args:
        layout: the scene's entities.
        effector: the end effector's kinematics.
        points: points of each entity that are read, its cloud's first.
        width: channels of the per-point network.
        size: channels of a token.
    """

    def __init__(self, layout: Layout, effector: EndEffector, points: int, width: int, size: int) -> None:
        super().__init__()
        self.free = [i for i, e in enumerate(layout) if not e.effector]
        self._links, self._points = [effector.root, *effector.sliding], points
        self.net = nn.Sequential(
            nn.Linear(12 + 5 * len(self._links), width), nn.GELU(), nn.Linear(width, width), nn.GELU()
        )
        self.out = nn.Linear(2 * width, size)

    def forward(self, state: RigidState, links: Tensor, links_next: Tensor) -> Tensor:
        """What is added to the tokens of the free entities (B, F, C).

        Args:
            state: the scenes.
            links: poses (B, 1 + S, 4, 4) of the root link and the sliding links.
            links_next: the same one step later, as far as they are known.
        """
        points, before = (self._cloud(state, state.frames[:, k]) for k in (0, 1))  # (B, F, n, 3)
        after = 2 * points - before
        root, root_next = links[:, :1], links_next[:, :1]
        local, local_next = _seen(points, root), _seen(after, root_next)
        height, falling = points[..., 2:], after[..., 2:] + FALL
        parts = [
            local / _LENGTH,
            (local_next - local) / _STEP,
            (points - before) @ root[..., :3, :3] / _STEP,
            height.clamp(-1, 1) / _LENGTH,
            torch.tanh(height / _NEAR),
            torch.tanh(falling / _NEAR),
        ]
        for i, k in enumerate(self._links):
            cloud = state.clouds[:, state.layout.entities[k].slice][:, : self._points]
            low, high = (x[:, None, None] for x in (cloud.amin(1), cloud.amax(1)))
            gap, _ = _box_gap(_seen(points, links[:, i, None]), low, high)
            gap_next, way = _box_gap(_seen(after, links_next[:, i, None]), low, high)
            parts += [torch.tanh(gap / _TOUCH), torch.tanh(gap_next / _TOUCH), torch.tanh(way / _NEAR)]
        features = self.net(torch.cat(parts, -1))
        return self.out(torch.cat([features.amax(-2), features.mean(-2)], -1))

    def _cloud(self, state: RigidState, poses: Tensor) -> Tensor:
        """World points (B, F, n, 3) of the free entities at poses (B, E, 4, 4)."""
        count = min(self._points, *(state.layout.entities[k].points for k in self.free))
        starts = [state.layout.entities[k].start for k in self.free]
        canonical = torch.stack([state.clouds[:, s : s + count] for s in starts], 1)
        return transform(poses[:, self.free], canonical)


def _seen(points: Tensor, pose: Tensor) -> Tensor:
    """World points (B, F, n, 3) in the frame of poses (B, 1, 4, 4)."""
    return (points - pose[..., None, :3, 3]) @ pose[..., :3, :3]


def _box_gap(points: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distance (..., 1) of points (..., 3) to a box, and the way to it (..., 3), zero inside."""
    beyond = torch.maximum(low - points, points - high)
    way = torch.minimum(torch.maximum(points, low), high) - points
    outside = way.square().sum(-1, keepdim=True).clamp_min(1e-12).sqrt()
    return outside + beyond.amax(-1, keepdim=True).clamp_max(0.0), way
