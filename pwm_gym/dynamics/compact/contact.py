"""What shapes and contacts tell: points of objects, corners of the links' bounding boxes, where both are going.

An object's points are carried on by their own velocities for one step, or by the hand, and the end effector's links by
what is known of their motion. Where the points then lie, above or below the table's surface and outside or inside the
links' boxes (of those of their points that are read), says who is about to hit whom. Small networks read it point by
point; the largest and the mean of their outputs tell the entities' tokens.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.response import EndEffector
from pwm_gym.scene import Layout, RigidState
from pwm_gym.scene.se3 import inverse, transform

__all__ = ["FALL", "ContactFeatures"]

FALL = -9.81 * 0.05**2
"""Metres by which free fall changes a step from one to the next: gravity times the control step squared."""

_LENGTH, _NEAR, _TOUCH, _STEP = 0.1, 0.01, 0.005, 0.01  # metres that count as 1


class ContactFeatures(nn.Module):
    """What the shape of each entity, and its contacts, tell its token.

    Args:
        layout: the scene's entities.
        effector: the end effector's kinematics.
        points: points of each entity that are read, its cloud's first.
        width: channels of the per-point networks.
        size: channels of a token.
    """

    def __init__(self, layout: Layout, effector: EndEffector, points: int, width: int, size: int) -> None:
        super().__init__()
        self.free = [i for i, e in enumerate(layout) if not e.driven]
        self._links, self._points = [effector.root, *effector.sliding], points
        order = [*self._links, *self.free]
        self._places = [order.index(i) for i in range(len(layout))]
        self.link = _Pooled(7, width, size)
        ends = torch.tensor([False, True])
        self.corners: Tensor
        self.register_buffer("corners", torch.cartesian_prod(ends, ends, ends), persistent=False)  # (8, 3)
        self.object = _Pooled(14 + 5 * len(self._links), width, size) if self.free else None

    def forward(self, state: RigidState, links: Tensor, links_next: Tensor) -> Tensor:
        """What the tokens of the entities are told (B, E, C).

        Args:
            state: the scenes.
            links: poses (B, 1 + S, 4, 4) of the root link and the sliding links.
            links_next: the same one step later, as far as they are known.
        """
        shapes = self._canonical(state, self._links)
        boxes = torch.stack([shapes.amin(-2), shapes.amax(-2)], 2)  # (B, 1 + S, 2, 3)
        told = [self.link(self._of_links(boxes, links, links_next))]
        if self.object is not None:
            told.append(self.object(self._of_objects(state, boxes, links, links_next)))
        return torch.cat(told, 1)[:, self._places]

    def middles(self, state: RigidState) -> Tensor:
        """Mean (B, F, 3) of the objects' canonical points that training reads, however many points a state has."""
        clouds = [state.clouds[:, state.layout.entities[k].slice] for k in self.free]
        return torch.stack([cloud[:, : self._points].mean(1) for cloud in clouds], 1)

    def _of_links(self, boxes: Tensor, links: Tensor, links_next: Tensor) -> Tensor:
        """Features (B, 1 + S, 8, K) of the boxes' corners: where they are, and how far they would enter the table."""
        low, high = boxes.unsqueeze(-2).unbind(2)  # (B, 1 + S, 1, 3)
        corners = torch.where(self.corners, high, low)
        points, after = transform(links, corners), transform(links_next, corners)
        height, next_height = points[..., 2:], after[..., 2:]
        parts = [
            _seen(points, links[:, :1]) / _LENGTH,
            height.clamp(-1, 1) / _LENGTH,
            torch.tanh(height / _NEAR),
            torch.tanh(next_height / _NEAR),
            torch.tanh(next_height / _TOUCH),
        ]
        return torch.cat(parts, -1)

    def _of_objects(self, state: RigidState, boxes: Tensor, links: Tensor, links_next: Tensor) -> Tensor:
        """Features (B, F, n, K) of the objects' points: motion, table, and the links' boxes."""
        now, before = state.frames[:, 0, self.free], state.frames[:, 1, self.free]  # (B, F, 4, 4)
        after = 2 * now - before
        seen = inverse(torch.cat([links, links_next], 1)).unsqueeze(1)  # (B, 1, 2 (1 + S), 4, 4)
        count = len(self._links)
        local, local_next = seen[:, :, :count] @ now.unsqueeze(2), seen[:, :, count:] @ after.unsqueeze(2)
        maps = [  # of canonical points, each (B, F, k, 4): all that is linear in a point is one product
            local[:, :, :, :3].flatten(2, 3),
            local_next[:, :, :, :3].flatten(2, 3),
            seen[:, :, 0, :3, :3] @ (now - before)[:, :, :3],
            now[:, :, 2:3],
            after[:, :, 2:3],
            links_next[:, None, 0, 2:3] @ local[:, :, 0],
        ]
        points = nn.functional.pad(self._canonical(state, self.free), (0, 1), value=1.0)
        mapped = torch.cat(maps, 2) @ points.transpose(-1, -2)  # (B, F, k, n): operations on it run along the points
        places, velocity, height, falling, carried = mapped.split([6 * count, 3, 1, 1, 1], 2)
        places = places.unflatten(2, (2, count, 3))  # now or next, link, coordinate
        gaps, ways = _box_gap(places, *boxes[:, None, None, ..., None].unbind(-3))
        touching = torch.cat([gaps.transpose(2, 3) / _TOUCH, ways[:, :, 1] / _NEAR], 3)
        parts = [
            places[:, :, 0, 0] / _LENGTH,
            (places[:, :, 1, 0] - places[:, :, 0, 0]) / _STEP,
            velocity / _STEP,
            height.clamp(-1, 1) / _LENGTH,
            torch.tanh(torch.cat([height / _NEAR, (falling + FALL) / _NEAR, carried / _NEAR, carried / _TOUCH], 2)),
            torch.tanh(touching).flatten(2, 3),
        ]
        return torch.cat(parts, 2).transpose(-1, -2)

    def _canonical(self, state: RigidState, entities: list[int]) -> Tensor:
        """Canonical points (B, F, n, 3) of some entities, equally many of each."""
        chosen = [state.layout.entities[k] for k in entities]
        count = min(self._points, *(e.points for e in chosen))
        return torch.stack([state.clouds[:, e.start : e.start + count] for e in chosen], 1)


class _Pooled(nn.Module):
    """A network of points, and what its largest and mean outputs tell."""

    def __init__(self, features: int, width: int, size: int) -> None:
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(features, width), nn.ReLU(inplace=True), nn.Linear(width, width), nn.ReLU(inplace=True)
        )
        self.out = nn.Linear(2 * width, size)

    def forward(self, features: Tensor) -> Tensor:
        """(..., C) of points' features (..., n, K)."""
        hidden = self.net(features)
        return self.out(torch.cat([hidden.amax(-2), hidden.mean(-2)], -1))


def _seen(points: Tensor, pose: Tensor) -> Tensor:
    """World points (B, F, n, 3) in the frame of poses (B, 1, 4, 4)."""
    return (points - pose[..., None, :3, 3]) @ pose[..., :3, :3]


def _box_gap(points: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distance (..., n) of points (..., 3, n) to a box, and the way to it (..., 3, n), zero inside."""
    beyond = torch.maximum(low - points, points - high)
    way = torch.minimum(torch.maximum(points, low), high) - points
    outside = way.square().sum(-2).clamp_min(1e-12).sqrt()
    return outside + beyond.amax(-2).clamp_max(0.0), way
