"""How what the robot does not drive moves: carried, pushed, in free flight, along a joint, or at rest.

Each mover's twist is a gated sum: of the motions of its carriers (links, articulated parts, other objects), of the ways
out of what would enter it, of free flight (articulated parts: of their own last motion) and of a learned twist. Gates
reach 0 and 1 exactly, so that what nothing touches rests and what is held does not slip, for any number of steps.
Carriers are resolved in the order robot, articulated parts, objects. What is fixed to something that moves follows it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.compact.contact import PAIR_FEATURES, Contacts
from pwm_gym.dynamics.compact.gates import gate
from pwm_gym.dynamics.compact.plan import Plan
from pwm_gym.dynamics.compact.shapes import Shapes
from pwm_gym.dynamics.response import twist
from pwm_gym.scene.joint import JOINT_KINDS
from pwm_gym.scene.se3 import inverse, make_pose, rotation_from_vector, transform

__all__ = ["MoverMotion", "Scales"]

_LEVER = 0.01  # metres: makes a turn a speed
_RESTS, _MOVES = 0.0005, 0.001  # metres a step: what is slower does not fly at all, or hardly
_MATCH, _HIDDEN = 32, 16  # channels that match movers with partners
_MOST_PUSH = 1.5  # of the way out of what would enter a mover
_SWEEPS = 2  # over objects that carry and push each other


@dataclass(frozen=True)
class Scales:
    """Motions of one step that count as 1."""

    translation: float = 0.01
    """Metres."""
    rotation: float = 0.05
    """Radians."""


@dataclass(frozen=True)
class _Decoded:
    """What the tokens say of each mover."""

    carry: Tensor
    """Share (B, F, P) of each partner's motion that a mover takes."""
    push: Tensor
    """Share (B, F, P) of the way out of each partner."""
    learned: Tensor
    """Twists (B, F, 6) in the frame of reference, in scales' units, gated."""
    flying: Tensor
    """Gate (B, F, 1)."""
    fall: Tensor
    """Share (B, F, 1) of gravity's change of a step."""


class MoverMotion(nn.Module):
    """Next poses of the movers.

    Args:
        links: number L of the robot's links, each with a bias of its own as a carrier.
        width: channels of a token.
        fall: metres by which free fall changes a step from one to the next.
        scales: units of learned twists.
    """

    def __init__(self, links: int, width: int, fall: float, scales: Scales) -> None:
        super().__init__()
        self._fall, self._scales = fall, scales
        self.query, self.key = nn.Linear(width, 2 * _MATCH), nn.Linear(width, 2 * _MATCH)
        self.pair = nn.Sequential(nn.Linear(PAIR_FEATURES, _HIDDEN), nn.GELU(), nn.Linear(_HIDDEN, 2))
        self.link_bias = nn.Parameter(torch.zeros(links, 2))
        self.kind_bias = nn.Parameter(torch.full((len(JOINT_KINDS), 2), -1.0))
        self.head = nn.Linear(width, 9)  # moving, flying, fall, twist
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        nn.init.constant_(self.head.bias[1], -3.0)  # nothing flies
        nn.init.constant_(self.head.bias[2], 2.0)

    def forward(
        self,
        plan: Plan,
        poses: Tensor,
        moves: Tensor,
        shapes: Shapes,
        contacts: Contacts,
        tokens: Tensor,
        links_next: Tensor,
        frame: Tensor,
    ) -> Tensor:
        """Next poses (B, P, 4, 4) of all entities, in the plan's order.

        Args:
            plan: of the scenes' layout.
            poses: (B, 3, P, 4, 4) at t, t-1, t-2.
            moves: last world-frame twists (B, P, 6).
            shapes: of the entities.
            contacts: of the movers.
            tokens: (B, P, C).
            links_next: the links' next poses (B, L, 4, 4).
            frame: rotation (B, 3, 3) of the frame of reference.
        """
        now = poses[:, 0]
        decoded = self._decode(plan, contacts, tokens)
        following = torch.cat([links_next, now[:, plan.links :]], 1)
        positions = now.new_zeros(len(now), 0)
        if plan.articulated:
            positions = self._articulate(plan, poses, moves, contacts, decoded, links_next)
        following = plan.tree.place(following, positions, now)
        if not plan.loose:
            return following
        count = len(plan.loose)
        middle = shapes.middles[:, plan.loose_places]
        centre = transform(poses[:, :2, plan.loose_places], middle[:, None, :, None]).squeeze(-2)
        motion = self._loose(plan, now, following, moves, centre, contacts, decoded, frame)
        if count > 1:
            motion = self._sweep(plan, centre[:, 0], motion, contacts.push, decoded)
        moved = _turn_about(now[:, plan.loose_places], middle, centre[:, 0], motion)
        parts = list(following.unbind(1))
        for place, pose in zip(plan.loose, moved.unbind(1), strict=True):
            parts[place] = pose
        following = torch.stack(parts, 1)
        return plan.tree.place(following, positions, now) if plan.ridden else following

    def _decode(self, plan: Plan, contacts: Contacts, tokens: Tensor) -> _Decoded:
        own = tokens[:, plan.movers]
        query = self.query(own).unflatten(-1, (2, -1))
        key = self.key(tokens[:, : plan.partners]).unflatten(-1, (2, -1))
        matched = torch.einsum("bfgc,bpgc->bfpg", query, key) * _MATCH**-0.5
        bias = torch.cat([self.link_bias, self.kind_bias[plan.kinds]])[: plan.partners]  # (P, 2)
        gates = gate(matched + self.pair(contacts.pairs) + bias)
        carry = gates[..., 0] * ~plan.itself
        carry = carry / carry.sum(-1, keepdim=True).clamp_min(1.0)
        moving, flying, fall, twists = self.head(own).split([1, 1, 1, 6], -1)
        return _Decoded(carry, _MOST_PUSH * gates[..., 1], gate(moving) * twists, gate(flying), torch.sigmoid(fall))

    def _loose(
        self,
        plan: Plan,
        now: Tensor,
        following: Tensor,
        moves: Tensor,
        centre: Tensor,
        contacts: Contacts,
        decoded: _Decoded,
        frame: Tensor,
    ) -> Tensor:
        """Twists (B, F, 6) of loose movers without what other loose ones do to them.

        Args:
            plan: of the layout.
            now: poses (B, P, 4, 4).
            following: next ones, of links, articulated parts and what is attached to them.
            moves: last twists (B, P, 6).
            centre: the movers' middles (B, 2, F, 3), now and before.
            contacts: of the movers.
            decoded: what the tokens say.
            frame: rotation (B, 3, 3) of the frame of reference.
        """
        count = len(plan.loose)
        known = plan.carriers
        push = contacts.push[:, :count]
        twisted = decoded.learned[:, :count]
        turned = frame.transpose(1, 2)
        learned = [
            twisted[..., :3] @ turned * self._scales.translation,
            twisted[..., 3:] @ turned * self._scales.rotation,
        ]
        gone = centre[:, 0] - centre[:, 1]
        fall = gone.new_tensor([0.0, 0.0, self._fall]) * decoded.fall[:, :count]
        spin = moves[:, plan.loose_places, 3:]
        free = _moving(gone, spin)
        flying = decoded.flying[:, :count] * (1.0 - (1.0 - free) * (1.0 - contacts.unsupported[:, :count]))
        way, turn = learned[0] + flying * (gone + fall), learned[1] + flying * spin
        if plan.carried:
            carry = decoded.carry[:, :count, known]
            carriers, after = now[:, known], following[:, known]
            relative = after @ inverse(carriers)  # (B, K, 4, 4)
            carried = transform(relative.unsqueeze(1), centre[:, 0, :, None, None]).squeeze(-2) - centre[
                :, 0
            ].unsqueeze(2)
            way = way + (carry.unsqueeze(-1) * carried).sum(2)
            turn = turn + carry @ twist(carriers, after)[..., 3:]
            way = way + (decoded.push[:, :count, known].unsqueeze(-1) * push[:, :, known]).sum(2)
        return torch.cat([way, turn], -1)

    @staticmethod
    def _sweep(plan: Plan, centre: Tensor, motion: Tensor, push: Tensor, decoded: _Decoded) -> Tensor:
        """Twists (B, F, 6) with what loose movers at middles (B, F, 3) do to each other added."""
        count = len(plan.loose)
        carry = decoded.carry[:, :count, plan.loose_places]  # (B, F, F)
        pushed = (decoded.push[:, :count, plan.loose_places].unsqueeze(-1) * push[:, :count, plan.loose_places]).sum(2)
        own = motion + torch.cat([pushed, torch.zeros_like(pushed)], -1)
        offset = centre.unsqueeze(2) - centre.unsqueeze(1)  # (B, F, F, 3)
        motion = own
        for _ in range(_SWEEPS):
            rotation = rotation_from_vector(motion[..., 3:]).unsqueeze(1)
            turned = (rotation @ offset.unsqueeze(-1)).squeeze(-1) - offset
            carried = (carry.unsqueeze(-1) * (motion[..., :3].unsqueeze(1) + turned)).sum(2)
            motion = own + torch.cat([carried, carry @ motion[..., 3:]], -1)
        return motion

    def _articulate(
        self, plan: Plan, poses: Tensor, moves: Tensor, contacts: Contacts, decoded: _Decoded, links_next: Tensor
    ) -> Tensor:
        """Next positions (B, S) of articulated parts' joints.

        A joint takes what its carriers' motion at the contact, and the way out of what would enter it, are along it.
        """
        first, tree = len(plan.loose), plan.tree
        positions = tree.positions(poses)  # (B, 3, S)
        assert contacts.touching is not None
        touching = contacts.touching[:, first:]  # (B, S, P, 3)
        now = poses[:, 0]
        moved = torch.cat([twist(now[:, : plan.links], links_next), moves[:, plan.links :]], 1)
        moved, partners = moved[:, : plan.partners], now[:, : plan.partners]
        offset = touching - partners[:, None, :, :3, 3]
        velocity = moved[:, None, :, :3] + torch.linalg.cross(moved[:, None, :, 3:].expand_as(offset), offset)
        along = self._along(plan, now, touching)  # (B, S, P, 3)
        carried = (decoded.carry[:, first:] * (velocity * along).sum(-1)).sum(-1)
        pushed = (decoded.push[:, first:] * (contacts.push[:, first:] * along).sum(-1)).sum(-1)
        inertia = decoded.flying[:, first:, 0] * (positions[:, 0] - positions[:, 1])
        unit = torch.where(tree.revolute, self._scales.rotation, self._scales.translation)
        step = carried + pushed + inertia + unit * decoded.learned[:, first:, 0]
        return tree.limit(positions[:, 0] + step)

    @staticmethod
    def _along(plan: Plan, now: Tensor, points: Tensor) -> Tensor:
        """Vectors (B, S, P, 3) whose products with velocities of points (B, S, P, 3) are joints' speeds."""
        tree, world = plan.tree, torch.eye(4, device=now.device).expand(len(now), 4, 4)
        parents = torch.stack([world if p is None else now[:, p] for p in tree.parents], 1)  # (B, S, 4, 4)
        axis = (parents[:, :, :3, :3] @ tree.axes.unsqueeze(-1)).squeeze(-1).unsqueeze(2).expand_as(points)
        centre = transform(parents, tree.anchors.unsqueeze(-2))  # (B, S, 1, 3)
        lever = torch.linalg.cross(axis, points - centre)
        turning = lever / lever.square().sum(-1, keepdim=True).clamp_min(_LEVER**2)
        return torch.where(tree.revolute[:, None, None], turning, axis)


def _moving(gone: Tensor, turned: Tensor) -> Tensor:
    """0 where a mover rested in a step by ``gone`` and ``turned`` (B, F, 3), near 1 where it moved; (B, F, 1)."""
    speed = (torch.cat([gone, _LEVER * turned], -1).square().sum(-1, keepdim=True) + 1e-12).sqrt()
    return torch.tanh((speed - _RESTS).clamp_min(0.0) / _MOVES)


def _turn_about(pose: Tensor, middle: Tensor, centre: Tensor, move: Tensor) -> Tensor:
    """Poses (B, F, 4, 4) moved by twists (B, F, 6) about their canonical points ``middle``, which lie at ``centre``."""
    rotation = rotation_from_vector(move[..., 3:]) @ pose[..., :3, :3]
    return make_pose(rotation, centre + move[..., :3] - (rotation @ middle.unsqueeze(-1)).squeeze(-1))
