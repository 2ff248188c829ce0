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

from pwm_gym.dynamics.compact.boxes import Coordinates, box_depth, box_gap, box_gap_and_way, coordinates, turned
from pwm_gym.dynamics.compact.plan import Plan
from pwm_gym.dynamics.compact.shapes import LENGTH, NEAR, TOUCH, Pooled, Shapes
from pwm_gym.scene.se3 import transform

__all__ = ["PAIR_FEATURES", "Contacts", "MoverContacts"]

_STEP = 0.01  # metres that count as 1
_DEPTH, _SPEED = 0.002, 0.001
_FADE = 0.03  # metres beyond which entities that are no links do not see each other
_HANGING, _HANGS = 0.004, 0.004  # metres: what is farther than the first (plus the second) from all is unsupported
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
    gaps: tuple[Tensor, Tensor]
    """Smallest gaps (B, F, P), metres, now and one step ahead; negative where they overlap."""
    unsupported: Tensor
    """0 (B, F, 1) where something touches the mover, 1 where nothing is near."""
    touching: Tensor | None
    """World-frame point (B, F, P, 3) of each mover that is nearest to each partner, where some move along joints."""


@dataclass(frozen=True)
class _Nearest:
    """Of movers (F) and partners (P): the points of the one that are nearest to, or deepest in, a box of the other."""

    gap: Tensor
    """Signed distances (B, F, P), metres."""
    way: Coordinates
    """Ways out of the box in its axes, each (B, F, P, 1)."""


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
        self.net = Pooled(own + 5 * links + 6, width, size)

    def forward(
        self,
        plan: Plan,
        poses: Tensor,
        shapes: Shapes,
        moves: Tensor,
        links_next: Tensor,
        frames: Tensor,
        seen: Tensor,
    ) -> Contacts:
        """Contacts of scenes (B,) with at least one mover; entities are in the plan's order.

        Args:
            plan: of the scenes' layout.
            poses: (B, 3, P, 4, 4) at t, t-1, t-2.
            shapes: of the entities.
            moves: last world-frame twists (B, P, 6).
            links_next: foreseen poses (B, L, 4, 4) of the links.
            frames: poses (B, 2, 4, 4) of the frame of reference, now and as foreseen.
            seen: their inverses (B, 2, 3, 4).
        """
        now, before = poses[:, 0], poses[:, 1]
        others = torch.lerp(before[:, self._links :], now[:, self._links :], 2.0)  # as fast as in the last step
        both = torch.stack([now, torch.cat([links_next, others], 1)], 1)  # (B, 2, P, 4, 4)
        centre, half = 0.5 * (shapes.low + shapes.high), 0.5 * (shapes.high - shapes.low)
        turns = both[..., :3, :3].transpose(-1, -2)
        shift = turns @ both[..., :3, 3:] + centre[:, None, ..., None]
        boxes = torch.cat([turns, -shift], -1)  # (B, 2, P, 3, 4): from the world to the axes of each entity's box
        (rows, local), sizes = self._rows(plan, poses, both, boxes, seen), plan.box_rows
        points = self._look_closer(plan, shapes, local, half)
        count = plan.partners
        product = rows @ points[:, plan.movers]  # (B, F, R, n): all that is linear in the movers' points
        boxed, height, place, boxed_next, *others_rows = product.split([*sizes, *sizes, 3, len(self._hands)], 2)
        back = self._theirs(plan, local, points, centre)
        sides = coordinates(plan.with_walls(half[:, :count], plan.wall_half, 1)[:, None, ..., None], 3)
        gap = box_gap(_axes(boxed), sides) + plan.apart
        gap_next, out = box_gap_and_way(_axes(boxed_next), sides)
        gap_next = gap_next + plan.apart
        ahead, own = both[:, 1], coordinates(half[:, plan.movers, None, :, None], 3)
        least, index = gap_next[:, :, :count].min(-1)
        least_back, index_back = (box_gap(back, own) + plan.apart[:, :count]).min(-1)
        here = _Nearest(least, _at(out, index))
        theirs = _Nearest(least_back, box_gap_and_way(_at(back, index_back), own)[1])
        nearest, push = self._pushes(ahead[:, None, :count, :3, :3], ahead[:, plan.movers, None, :3, :3], here, theirs)
        lowest = gap.amin(-1)
        pairs = self._pairs(
            now[:, :count], now[:, plan.movers], moves[:, :count], moves[:, plan.movers], lowest[:, :, :count], nearest
        )
        axes = plan.with_walls(turns[:, 1, :count], plan.walls[:, :3, :3], 1) @ frames[:, :1, :3, :3]
        told = self._own(plan, height, place, others_rows, links_next, centre)
        told += self._partners(gap, gap_next, turned(axes.transpose(-1, -2).unsqueeze(1), out))
        clear = torch.minimum(lowest.amin(-1), height.amin((-1, -2)) - plan.floor)
        return Contacts(
            told=self.net(told),
            pairs=pairs,
            push=push,
            gaps=(lowest[:, :, :count], nearest),
            unsupported=((clear - _HANGING) / _HANGS).clamp(0.0, 1.0).unsqueeze(-1),
            touching=self._touching(plan, ahead, points, index) if plan.articulated else None,
        )

    @staticmethod
    def _look_closer(plan: Plan, shapes: Shapes, local: Tensor, half: Tensor) -> Tensor:
        """Points (B, P, 4, n) to read: of movers, half are those of the larger clouds nearest to a partner's box.

        What a mover hangs on is left out: inside its box, every point would be near.

        What may be touched is told at the clouds' resolution, and the network reads no more points.

        Args:
            plan: of the layout.
            shapes: of the entities.
            local: maps (B, F, 3, P, 4) from the movers to the axes of the partners' boxes one step ahead.
            half: half the boxes' sides (B, P, 3).
        """
        points, clouds = shapes.points, shapes.clouds
        if clouds is None:
            return points
        count, near = plan.partners, points.shape[-1] // 2
        with torch.no_grad():
            boxed = _axes(local.flatten(2, 3) @ clouds)  # (B, F, P, m) each
            gaps = box_depth(boxed, coordinates(half[:, None, :count, :, None], 3)) + plan.joined
            nearest = gaps.amin(2).topk(near, -1, largest=False).indices  # (B, F, n / 2)
        points = points.clone()
        points[:, plan.movers, :, -near:] = clouds.gather(-1, nearest.unsqueeze(2).expand(-1, -1, 4, -1))
        return points

    def _rows(self, plan: Plan, poses: Tensor, both: Tensor, boxes: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Maps (B, F, R, 4) of the movers' canonical points to all that is linear in them.

        Their places in the axes of the boxes of partners and walls (x of all, then y, then z), their height and their
        place in the frame of reference, now and one step ahead; their velocity; their heights if each hand carried
        them. The maps (B, F, 3, P, 4) to the axes of the partners' boxes one step ahead are told apart, too.
        """
        count, most = plan.partners, plan.touchable
        axes = boxes[:, :, :count].transpose(2, 3)  # (B, 2, 3, P, 4)
        if most > count:
            axes = torch.cat([axes, plan.wall_rows.expand(len(poses), 2, -1, -1, -1)], 3)
        up = plan.up.expand(len(poses), 2, -1, -1)
        outer = torch.cat([axes.flatten(2, 3), up, seen], 2)  # (B, 2, R', 4)
        movers = both[:, :, plan.movers]  # (B, 2, F, 4, 4)
        inner = (outer @ movers.transpose(2, 3).flatten(3)).unflatten(-1, (-1, 4)).permute(0, 3, 1, 2, 4)
        here = movers[:, 0]
        rows = [inner.flatten(2, 3), seen[:, :1, :, :3] @ (here - poses[:, 1, plan.movers])[:, :, :3]]
        rows += [both[:, 1, None, k, 2:3, :3] @ inner[:, :, 0, k : 3 * most : most] for k in self._hands]
        return torch.cat(rows, 2), inner[:, :, 1, : 3 * most].unflatten(2, (3, most))[:, :, :, :count]

    @staticmethod
    def _theirs(plan: Plan, local: Tensor, points: Tensor, centre: Tensor) -> Coordinates:
        """The partners' points, each (B, F, P, n), in the axes of the movers' boxes one step ahead.

        Args:
            plan: of the layout.
            local: maps (B, F, 3, P, 4) from the movers to the axes of the partners' boxes then.
            points: canonical ones (B, E, 4, n).
            centre: the boxes' middles (B, E, 3).
        """
        count, movers = plan.partners, len(plan.places)
        local = local.permute(0, 3, 1, 2, 4)  # (B, P, F, 3, 4)
        back = local[..., :3].transpose(-1, -2)
        shift = back @ (local[..., 3:] + centre[:, :count, None, :, None]) + centre[:, None, plan.movers, :, None]
        # A product of fewer than 400 multiplications takes a loop that is slower than a larger one: hence a fourth row.
        back = nn.functional.pad(torch.cat([back, -shift], -1), (0, 0, 0, 1)).flatten(2, 3)  # (B, P, 4 F, 4)
        theirs = (back @ points[:, :count]).unflatten(2, (movers, 4)).transpose(1, 2)
        return coordinates(theirs[:, :, :, :3], 3)

    def _own(
        self, plan: Plan, height: Tensor, place: Tensor, others: list[Tensor], links_next: Tensor, centre: Tensor
    ) -> list[Tensor]:
        """Rows (B, F, k, n) of what each point tells without its partners.

        Args:
            plan: of the layout.
            height: (B, F, 1, n), metres.
            place: in the frame of reference (B, F, 3, n).
            others: height and place one step ahead, velocity, and turned with each hand (B, F, H, n).
            links_next: foreseen poses (B, L, 4, 4) of the links.
            centre: middles (B, P, 3) of the entities' boxes, which a hand's turn is about.
        """
        height_next, ahead, velocity, held = others
        height = height - plan.floor
        falling = height_next + (self._fall - plan.floor)
        if self._hands:  # the lowest if a hand carried it
            hands = plan.hands
            middles = (links_next[:, hands, 2, :3] * centre[:, hands]).sum(-1) + links_next[:, hands, 2, 3]  # (B, H)
            held = (held + (middles - plan.floor)[:, None, :, None]).amin(2, keepdim=True)
        else:
            held = height
        parts = torch.cat([height, falling, held, (NEAR / TOUCH) * held], 2) / NEAR
        return [
            place / LENGTH,
            (ahead - place) / _STEP,
            velocity / _STEP,
            height.clamp(-1, 1) / LENGTH,
            torch.tanh(parts),
        ]

    def _partners(self, gap: Tensor, gap_next: Tensor, out: Coordinates) -> list[Tensor]:
        """Rows (B, F, k, n) of what each point tells of its partners: of each link, and of all others together.

        Args:
            gap: of the movers' points to partners and walls (B, F, P', n) now.
            gap_next: the same one step ahead.
            out: ways out then, each (B, F, P', n).
        """
        known = torch.stack([gap / TOUCH, gap_next / TOUCH, *(way / NEAR for way in out)], 3).tanh()
        links = known[:, :, : self._links].flatten(2, 3)
        if known.shape[2] == self._links:
            return [links, known.new_zeros(*known.shape[:2], 6, known.shape[-1])]
        rest = known[:, :, self._links :]  # (B, F, k, 5, n)
        fade = (1.0 - gap_next[:, :, self._links :].unsqueeze(3) / _FADE).clamp(0.0, 1.0)
        near = torch.cat([fade, fade * (1.0 - rest[:, :, :, :2]), fade * rest[:, :, :, 2:]], 3)
        return [links, near.sum(2)]

    @staticmethod
    def _pushes(partners: Tensor, movers: Tensor, here: _Nearest, theirs: _Nearest) -> tuple[Tensor, Tensor]:
        """Smallest gaps (B, F, P) and world-frame ways out of partners (B, F, P, 3), one step ahead.

        Args:
            partners: rotations (B, 1, P, 3, 3).
            movers: rotations (B, F, 1, 3, 3).
            here: of the movers' points in the partners' boxes.
            theirs: of the partners' points in the movers' boxes.
        """
        way = torch.cat(turned(partners, here.way), -1)
        way_back = -torch.cat(turned(movers, theirs.way), -1)
        chosen = torch.where((theirs.gap < here.gap).unsqueeze(-1), way_back, way)
        nearest = torch.minimum(here.gap, theirs.gap)
        return nearest, chosen * (nearest < 0.0).unsqueeze(-1)

    @staticmethod
    def _touching(plan: Plan, ahead: Tensor, points: Tensor, index: Tensor) -> Tensor:
        """World-frame points (B, F, P, 3) of movers one step ahead.

        Args:
            plan: of the layout.
            ahead: poses (B, E, 4, 4) of all entities.
            points: canonical ones (B, E, 4, n).
            index: their places (B, F, P) among the movers'.
        """
        canonical = points[:, plan.movers, None, :3].expand(-1, -1, index.shape[2], -1, -1)
        chosen = canonical.gather(-1, index[..., None, None].expand(*index.shape, 3, 1)).squeeze(-1)
        return transform(ahead[:, plan.movers, None], chosen.unsqueeze(-2)).squeeze(-2)

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
        carried = theirs[..., :3] + torch.linalg.cross(theirs[..., 3:], offset)
        slip = (own[..., :3] - carried).square().sum(-1).clamp_min(1e-12).sqrt()
        speed = own[..., :3].square().sum(-1).clamp_min(1e-12).sqrt().expand_as(gap)
        rows = [
            gap / TOUCH,
            gap_next / TOUCH,
            gap_next.clamp_max(0.0) / _DEPTH,
            slip / _SPEED,
            speed / _SPEED,
            slip / _STEP,
            offset[..., 2] / NEAR,
        ]
        return torch.tanh(torch.stack(rows, -1))


def _axes(rows: Tensor) -> Coordinates:
    """Coordinates (B, F, P, n) of rows (B, F, 3 P, n): x of all, then y, then z."""
    return coordinates(rows.unflatten(2, (3, -1)), 2)


def _at(vectors: Coordinates, index: Tensor) -> Coordinates:
    """Coordinates (B, F, P, 1) of the vectors at places ``index`` (B, F, P) of (B, F, G, n), of the first P of G."""
    x, y, z = (part.gather(-1, index.unsqueeze(-1)) for part in vectors)
    return x, y, z
