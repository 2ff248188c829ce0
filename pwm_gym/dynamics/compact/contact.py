"""What shapes and contacts tell about the entities that can move.

Points of each mover are carried on by their own velocities for one step; its partners are the robot's links, where
they are foreseen, and all other entities, carried on likewise. Where the points then lie, outside or inside the
partners' bounding boxes (of those of their points that are read), and the partners' points in the mover's own box, say
who is about to hit whom, from which side and how deeply. Small networks read it point by point for the movers' tokens;
what is told pair by pair decides who carries and pushes whom.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.compact.plan import Plan
from pwm_gym.scene.se3 import inverse, transform

__all__ = ["PAIR_FEATURES", "Contacts", "LinkShapes", "MoverContacts"]

_LENGTH, _NEAR, _TOUCH, _STEP = 0.1, 0.01, 0.005, 0.01  # metres that count as 1
_DEPTH, _SPEED = 0.002, 0.001
_FADE = 0.03  # metres beyond which entities that are no links do not see each other
_HANGING, _HANGS = 0.004, 0.004  # metres: what is farther than the first (plus the second) from all is unsupported
_APART = 1.0  # metres that part a mover from itself, and from what hangs on it
PAIR_FEATURES = 7
"""Values of :attr:`Contacts.pairs`."""


@dataclass(frozen=True)
class Contacts:
    """Movers (F) and their partners (P: links, then all other entities, if they are several)."""

    told: Tensor
    """What each mover's token is told (B, F, C)."""
    pairs: Tensor
    """Features (B, F, P, Q) of pairs, of order 1."""
    push: Tensor
    """World-frame way (B, F, P, 3), metres, out of a partner that a mover would enter; zero elsewhere."""
    unsupported: Tensor
    """0 (B, F, 1) where something touches the mover, 1 where nothing is near."""
    touching: Tensor
    """World-frame point (B, F, P, 3) of each mover that is nearest to each partner."""


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


class LinkShapes(nn.Module):
    """What the links' tokens are told of their shapes, and of how far they would enter the floor.

    Args:
        width: channels of the per-point network.
        size: channels of a token.
    """

    corners: Tensor

    def __init__(self, width: int, size: int) -> None:
        super().__init__()
        ends = torch.tensor([False, True])
        self.register_buffer("corners", torch.cartesian_prod(ends, ends, ends), persistent=False)  # (8, 3)
        self.net = _Pooled(7, width, size)

    def forward(self, shapes: Tensor, links: Tensor, links_next: Tensor, frame: Tensor, floor: float) -> Tensor:
        """(B, L, C).

        Args:
            shapes: canonical points (B, L, n, 3).
            links: poses (B, L, 4, 4).
            links_next: the same one step later, as foreseen.
            frame: pose (B, 4, 4) of the frame of reference.
            floor: its height, metres.
        """
        low, high = shapes.amin(-2).unsqueeze(-2), shapes.amax(-2).unsqueeze(-2)  # (B, L, 1, 3)
        corners = torch.where(self.corners, high, low)
        points, after = transform(links, corners), transform(links_next, corners)
        height, next_height = points[..., 2:] - floor, after[..., 2:] - floor
        seen = (points - frame[:, None, None, :3, 3]) @ frame[:, None, :3, :3]
        parts = [
            seen / _LENGTH,
            height.clamp(-1, 1) / _LENGTH,
            torch.tanh(height / _NEAR),
            torch.tanh(next_height / _NEAR),
            torch.tanh(next_height / _TOUCH),
        ]
        return self.net(torch.cat(parts, -1))


class MoverContacts(nn.Module):
    """What is told of the entities that can move.

    Args:
        links: number L of the robot's links, which have weights of their own.
        hands: places of the hands among them.
        width: channels of the per-point network.
        size: channels of a token.
        fall: metres by which free fall changes a step from one to the next.
    """

    def __init__(self, links: int, hands: list[int], width: int, size: int, fall: float) -> None:
        super().__init__()
        self._links, self._hands, self._fall = links, hands, fall
        own = 3 + 3 + 3 + 1 + 4  # place, step, velocity, height, heights ahead
        self.net = _Pooled(own + 5 * links + 6, width, size)

    def forward(
        self, plan: Plan, poses: Tensor, shapes: Tensor, moves: Tensor, links_next: Tensor, frames: Tensor
    ) -> Contacts:
        """Contacts of scenes (B,) with at least one mover; entities are in the plan's order.

        Args:
            plan: of the scenes' layout.
            poses: (B, 3, P, 4, 4) at t, t-1, t-2.
            shapes: canonical points (B, P, n, 3).
            moves: last world-frame twists (B, P, 6).
            links_next: foreseen poses (B, L, 4, 4) of the links.
            frames: poses (B, 2, 4, 4) of the frame of reference, now and as foreseen.
        """
        now, before = poses[:, 0], poses[:, 1]
        ahead = torch.cat([links_next, (2.0 * now - before)[:, self._links :]], 1)
        here, there = now[:, plan.movers], ahead[:, plan.movers]
        points = nn.functional.pad(shapes[:, plan.movers], (0, 1), value=1.0).transpose(-1, -2)  # (B, F, 4, n)
        now, ahead, theirs = now[:, : plan.partners], ahead[:, : plan.partners], shapes[:, : plan.partners]
        moves_of_movers, moves = moves[:, plan.movers], moves[:, : plan.partners]
        local = inverse(now).unsqueeze(1) @ here.unsqueeze(2)  # (B, F, P, 4, 4)
        local_next = inverse(ahead).unsqueeze(1) @ there.unsqueeze(2)
        box = _box(theirs.unsqueeze(1))
        gap = _box_distance(local[:, :, :, :3] @ points.unsqueeze(2), *box)  # (B, F, P, n)
        gap_next, out = _box_gap(local_next[:, :, :, :3] @ points.unsqueeze(2), *box)
        alone = _APART * plan.itself.unsqueeze(-1)  # (F, P, 1)
        gap, gap_next = gap + alone, gap_next + alone
        nearest, touching, push = self._pushes(
            ahead, there, theirs, _box(shapes[:, plan.movers].unsqueeze(2)), points, local_next, (gap_next, out), plan
        )
        pairs = self._pairs(now, here, moves, moves_of_movers, gap.amin(-1), nearest)
        turned = (ahead[:, :, :3, :3].transpose(-1, -2) @ frames[:, :1, :3, :3]).transpose(-1, -2)
        out = turned.unsqueeze(1) @ out
        if len(plan.walls):
            gap, gap_next, out = self._with_walls(plan, (gap, gap_next, out), here, there, points, frames[:, 0])
        told = self._own(plan, here, there, before[:, plan.movers], points, local, links_next, frames)
        told += self._partners(gap, gap_next, out)
        clear = torch.minimum(gap.amin((-1, -2)), (here[:, :, 2:3] @ points).amin((-1, -2)) - plan.floor)
        return Contacts(
            told=self.net(torch.cat(told, 2).transpose(-1, -2)),
            pairs=pairs,
            push=push,
            unsupported=((clear - _HANGING) / _HANGS).clamp(0.0, 1.0).unsqueeze(-1),
            touching=touching,
        )

    @staticmethod
    def _with_walls(
        plan: Plan, known: tuple[Tensor, ...], here: Tensor, there: Tensor, points: Tensor, frame: Tensor
    ) -> list[Tensor]:
        """Gaps now and ahead and ways out, those of the fixed boxes of the world included."""
        half = plan.wall_half[:, :, None]
        gap = _box_distance((plan.walls[:, :3] @ here.unsqueeze(2)) @ points.unsqueeze(2), -half, half)
        gap_next, out = _box_gap((plan.walls[:, :3] @ there.unsqueeze(2)) @ points.unsqueeze(2), -half, half)
        turned = (plan.walls[:, :3, :3] @ frame[:, None, :3, :3]).transpose(-1, -2)  # (B, S, 3, 3)
        return [torch.cat(pair, 2) for pair in zip(known, (gap, gap_next, turned.unsqueeze(1) @ out), strict=True)]

    def _own(
        self,
        plan: Plan,
        here: Tensor,
        there: Tensor,
        before: Tensor,
        points: Tensor,
        local: Tensor,
        links_next: Tensor,
        frames: Tensor,
    ) -> list[Tensor]:
        """Rows (B, F, k, n) of what each point tells without its partners."""
        seen, seen_next = inverse(frames).unsqueeze(2).unbind(1)  # (B, 1, 4, 4) each
        maps = [  # of canonical points, each (B, F, k, 4): all that is linear in a point is one product
            (seen @ here)[:, :, :3],
            (seen_next @ there)[:, :, :3],
            seen[:, :, :3, :3] @ (here - before)[:, :, :3],
            here[:, :, 2:3],
            there[:, :, 2:3],
        ]
        maps += [links_next[:, None, k, 2:3] @ local[:, :, k] for k in self._hands]
        place, ahead, velocity, heights = (torch.cat(maps, 2) @ points).split([3, 3, 3, 2 + len(self._hands)], 2)
        heights = heights - plan.floor
        height, falling = heights[:, :, :1], heights[:, :, 1:2] + self._fall
        held = heights[:, :, 2:].amin(2, keepdim=True) if self._hands else height  # if a hand carried it
        parts = torch.cat([height / _NEAR, falling / _NEAR, held / _NEAR, held / _TOUCH], 2)
        return [
            place / _LENGTH,
            (ahead - place) / _STEP,
            velocity / _STEP,
            height.clamp(-1, 1) / _LENGTH,
            torch.tanh(parts),
        ]

    def _partners(self, gap: Tensor, gap_next: Tensor, out: Tensor) -> list[Tensor]:
        """Rows (B, F, k, n) of what each point tells of its partners: of each link, and of all others together."""
        known = torch.tanh(torch.cat([gap.unsqueeze(3) / _TOUCH, gap_next.unsqueeze(3) / _TOUCH, out / _NEAR], 3))
        links, rest = known[:, :, : self._links], known[:, :, self._links :]  # (B, F, k, 5, n)
        fade = (1.0 - gap_next[:, :, self._links :] / _FADE).clamp(0.0, 1.0).unsqueeze(3)
        near = torch.cat([fade, fade * (1.0 - rest[:, :, :, :2]), fade * rest[:, :, :, 2:]], 3)
        return [links.flatten(2, 3), near.sum(2)]

    @staticmethod
    def _pushes(
        ahead: Tensor,
        there: Tensor,
        shapes: Tensor,
        box: tuple[Tensor, Tensor],
        points: Tensor,
        local_next: Tensor,
        known: tuple[Tensor, Tensor],
        plan: Plan,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Smallest gaps (B, F, P), nearest points (B, F, P, 3) and ways out (B, F, P, 3), one step ahead.

        Both the movers' points in the partners' boxes count, and the partners' points in the movers' boxes.
        """
        gap, out = known
        nearest, index = gap.min(-1)
        way = (ahead[:, None, :, :3, :3] @ _at(out, index).unsqueeze(-1)).squeeze(-1)
        theirs = nn.functional.pad(shapes, (0, 1), value=1.0).transpose(-1, -2).unsqueeze(1)  # (B, 1, P, 4, n)
        gap_back, out_back = _box_gap(inverse(local_next)[:, :, :, :3] @ theirs, *box)
        nearest_back, index_back = (gap_back + _APART * plan.itself.unsqueeze(-1)).min(-1)
        way_back = -(there[:, :, None, :3, :3] @ _at(out_back, index_back).unsqueeze(-1)).squeeze(-1)
        smallest = torch.minimum(nearest, nearest_back)
        chosen = torch.where((nearest_back < nearest).unsqueeze(-1), way_back, way)
        own = _at(points[:, :, None, :3].expand(-1, -1, index.shape[2], -1, -1), index)
        touching = (there[:, :, None, :3, :3] @ own.unsqueeze(-1)).squeeze(-1) + there[:, :, None, :3, 3]
        return smallest, touching, chosen * (smallest < 0.0).unsqueeze(-1)

    @staticmethod
    def _pairs(now: Tensor, here: Tensor, moves: Tensor, own: Tensor, gap: Tensor, gap_next: Tensor) -> Tensor:
        """Features (B, F, P, Q) of pairs.

        Args:
            now: partners' poses (B, P, 4, 4).
            here: movers' poses (B, F, 4, 4).
            moves: partners' last twists (B, P, 6).
            own: movers' last twists (B, F, 6).
            gap: smallest gaps (B, F, P) now, metres.
            gap_next: the same one step ahead.
        """
        offset = here[:, :, None, :3, 3] - now[:, None, :, :3, 3]
        theirs, own = moves.unsqueeze(1), own.unsqueeze(2)
        carried = theirs[..., :3] + torch.linalg.cross(theirs[..., 3:].expand_as(offset), offset)
        slip = (own[..., :3] - carried).square().sum(-1).clamp_min(1e-12).sqrt()
        speed = own[..., :3].square().sum(-1).clamp_min(1e-12).sqrt().expand_as(gap)
        rows = [
            gap / _TOUCH,
            gap_next / _TOUCH,
            gap_next.clamp_max(0.0) / _DEPTH,
            slip / _SPEED,
            speed / _SPEED,
            slip / _STEP,
            offset[..., 2] / _NEAR,
        ]
        return torch.tanh(torch.stack(rows, -1))


def _at(vectors: Tensor, index: Tensor) -> Tensor:
    """Vectors (..., 3) of (..., 3, n) at places (...)."""
    return vectors.gather(-1, index[..., None, None].expand(*index.shape, 3, 1)).squeeze(-1)


def _box(shapes: Tensor) -> tuple[Tensor, Tensor]:
    """Corners (..., 3, 1) of the boxes around points (..., n, 3)."""
    return shapes.amin(-2).unsqueeze(-1), shapes.amax(-2).unsqueeze(-1)


def _box_distance(points: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Signed distance (..., n) of points (..., 3, n) to a box."""
    beyond = torch.maximum(low - points, points - high)
    outside = beyond.clamp_min(0.0).square().sum(-2).clamp_min(1e-12).sqrt()
    return outside + beyond.amax(-2).clamp_max(0.0)


def _box_gap(points: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distance (..., n) of points (..., 3, n) to a box, and the outward vector (..., 3, n) of that length.

    The vector leads from the box's surface to a point outside, and from a point inside to the nearest face.
    """
    below, above = low - points, points - high
    beyond = torch.maximum(below, above)
    outward = above.clamp_min(0.0) - below.clamp_min(0.0)
    outside = outward.square().sum(-2).clamp_min(1e-12).sqrt()
    deepest = beyond.amax(-2, keepdim=True)
    inside = deepest.clamp_max(0.0)
    side = torch.where(above > below, 1.0, -1.0) * (beyond == deepest)
    return outside + inside.squeeze(-2), outward - inside * side
