"""Kinematics of a scene's joints with one degree of freedom: fingers on a hand, drawers, lids."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.scene.layout import Layout
from pwm_gym.scene.se3 import (
    make_pose,
    matrix_from_pose7,
    motion_vector,
    rotation_about,
    rotation_from_vector,
    rotation_parts,
)

__all__ = ["JointTree"]

_TURN = 2.0 * math.pi  # radians


class JointTree(nn.Module):
    """Positions of joints from entity poses, and entity poses from positions; batched and differentiable.

    Args:
        layout: the scene's entities.
        moving: positions in the layout of the entities whose joints these are, S of them; parents come first.
        attached: positions of entities that are fixed to others, and go where those go.
    """

    parts: Tensor
    axes: Tensor
    anchors: Tensor
    shifts: Tensor
    starts: Tensor
    sines: Tensor
    cosines: Tensor
    revolute: Tensor
    lower: Tensor
    upper: Tensor
    gains: Tensor
    offsets: Tensor

    def __init__(self, layout: Layout, moving: Sequence[int], attached: Sequence[int] = ()) -> None:
        super().__init__()
        self.moving, entities = list(moving), [layout.entities[i] for i in moving]
        joints = [e.joint for e in entities]
        self.parents = [None if j.parent is None else layout.index(j.parent) for j in joints]
        self._order = self._parents_first(layout, attached)
        origin = matrix_from_pose7(
            torch.tensor([j.origin for j in joints], dtype=torch.float32).reshape(-1, 7)
        )  # (S, 4, 4)
        axis = torch.tensor([j.axis for j in joints], dtype=torch.float32).reshape(-1, 3)
        turns = torch.tensor([j.kind == "revolute" for j in joints], dtype=torch.bool)
        fixed, by_cosine, by_sine = rotation_parts(axis)
        spread = turns[:, None, None]
        still = torch.eye(3).expand_as(fixed)
        rotation = torch.stack([fixed.where(spread, still), by_cosine * spread, by_sine * spread])
        corner = F.pad(torch.ones(1, 1, 1), (3, 0, 3, 0))
        parts = origin @ (F.pad(rotation, (0, 1, 0, 1)) + torch.stack([corner, 0 * corner, 0 * corner]))
        turned = origin[:, :3, :3]
        shifts = (turned @ axis.unsqueeze(-1)).squeeze(-1)
        follow = [j.mimic for j in joints]
        places = {e.name: k for k, e in enumerate(entities)}
        tables = {
            "parts": parts,  # (3, S, 4, 4): the entity's frame in its parent's: fixed, by cosine, by sine
            "axes": shifts,  # (S, 3): unit axes in the parents' frames
            "anchors": origin[:, :3, 3].clone(),  # (S, 3): points on them
            "shifts": shifts * ~turns.unsqueeze(-1),  # (S, 3): way in the parent's frame per metre
            "starts": (origin[:, :3, 3] * shifts).sum(-1),  # (S,): where a sliding entity is along it at position 0
            "sines": 0.5 * turned @ by_sine,  # (S, 3, 3): products with a relative rotation give sine and cosine
            "cosines": 0.5 * turned @ by_cosine,
            "revolute": turns,
            "lower": torch.tensor([j.lower for j in joints], dtype=torch.float32),
            "upper": torch.tensor([j.upper for j in joints], dtype=torch.float32),
            "gains": torch.tensor([1.0 if m is None else m.multiplier for m in follow], dtype=torch.float32),
            "offsets": torch.tensor([0.0 if m is None else m.offset for m in follow], dtype=torch.float32),
        }
        for name, value in tables.items():
            self.register_buffer(name, value, persistent=False)
        self._leaders = [k if m is None else places[m.entity] for k, m in enumerate(follow)]
        self._mimics = any(m is not None for m in follow)
        self._turns = bool(turns.any())

    def __len__(self) -> int:
        return len(self.moving)

    def _parents_first(self, layout: Layout, attached: Sequence[int]) -> list[tuple[int, int | None, int | None]]:
        """Place, parent and joint, if any, of every entity that hangs on another, parents first."""
        joints = {entity: k for k, entity in enumerate(self.moving)}
        names = [layout.names[i] for i in {*joints, *attached}]
        order = sorted(map(layout.index, names), key=layout.depth)
        parents = [layout.entities[i].joint.parent for i in order]
        places = [None if name is None else layout.index(name) for name in parents]
        return [(i, parent, joints.get(i)) for i, parent in zip(order, places, strict=True)]

    def positions(self, poses: Tensor) -> Tensor:
        """Joint positions (..., S) of entity poses (..., E, 4, 4): radians, or metres."""
        child, parent = poses[..., self.moving, :, :], self._parents(poses)
        turned = parent[..., :3, :3].transpose(-1, -2)
        offset = (turned @ (child[..., :3, 3:] - parent[..., :3, 3:])).squeeze(-1)  # (..., S, 3)
        sliding = (offset * self.shifts).sum(-1) - self.starts
        if not self._turns:
            return sliding
        rotation = turned @ child[..., :3, :3]
        angle = torch.atan2((self.sines * rotation).sum((-1, -2)), (self.cosines * rotation).sum((-1, -2)))
        middle = 0.5 * (self.lower + self.upper)  # of several turns that a pose may mean, the one nearest to it
        angle = angle + _TURN * ((middle - angle) / _TURN).round()
        return torch.where(self.revolute, angle, sliding)

    def between(self, before: Tensor, after: Tensor) -> Tensor:
        """Ways (..., S) from joint positions to others, of angles the shorter way round."""
        way = after - before
        if not self._turns:
            return way
        return torch.where(self.revolute, way - _TURN * (way / _TURN).round(), way)

    def _parents(self, poses: Tensor) -> Tensor:
        """Parents' poses (..., S, 4, 4); the identity for the world."""
        world = torch.eye(4, dtype=poses.dtype, device=poses.device).expand(*poses.shape[:-3], 4, 4)
        found = [world if p is None else poses[..., p, :, :] for p in self.parents]
        return torch.stack(found, -3) if found else poses[..., :0, :, :]

    def local(self, positions: Tensor) -> Tensor:
        """Poses (..., S, 4, 4) in the parents' frames at joint positions (..., S)."""
        pose = rotation_about(self.parts, positions) if self._turns else self.parts[0].expand(*positions.shape, 4, 4)
        shift = F.pad((self.shifts * positions.unsqueeze(-1)).unsqueeze(-1), (3, 0, 0, 1))  # into the last column
        return pose + shift

    def place(self, poses: Tensor, positions: Tensor, before: Tensor | None = None) -> Tensor:
        """Entity poses (..., E, 4, 4) with these joints at ``positions`` (..., S); what is attached follows.

        Args:
            poses: where the parents are.
            positions: radians, or metres.
            before: poses a step ago, which tell how attached entities hang; only needed where there are some.
        """
        if not self._order:
            return poses
        local, moved = self.local(positions).unbind(-3), list(poses.unbind(-3))
        old = (poses if before is None else before).unbind(-3)
        for entity, parent, k in self._order:
            if k is None:
                assert parent is not None
                moved[entity] = _carried(old[entity], old[parent], moved[parent])
            else:
                moved[entity] = local[k] if parent is None else moved[parent] @ local[k]
        return torch.stack(moved, -3)

    def limit(self, positions: Tensor) -> Tensor:
        """Positions (..., S) within their limits; joints that follow another are where its position puts them."""
        if self._mimics:
            positions = self.gains * positions[..., self._leaders] + self.offsets
        return torch.minimum(torch.maximum(positions, self.lower), self.upper)


def _carried(pose: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """Poses (..., 4, 4) of what is fixed to bodies that moved from ``before`` to ``after``; exactly still if they did.

    The turn is made from its vector, so that it is one however far the rotations are from orthonormal.
    """
    turn = rotation_from_vector(motion_vector(after[..., :3, :3] @ before[..., :3, :3].transpose(-1, -2)))
    offset = pose[..., :3, 3:] - before[..., :3, 3:]
    way = after[..., :3, 3:] - before[..., :3, 3:] + (turn @ offset - offset)
    return make_pose(turn @ pose[..., :3, :3], (pose[..., :3, 3:] + way).squeeze(-1))
