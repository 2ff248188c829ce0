"""Which of several objects is moved next, and where to: those in others' way are put aside first.

An object *waits* for another one that is not settled while that one stands on it, stands where it is to go, or is to
stand beneath it. Objects that wait for each other in a ring (two that change places) are a *knot*: one of them is put
aside. What counts is the number of moves that are left: one an unsettled object, and one a knot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.several import Several
from pwm_gym.costs.terms import Info, Place, Term

__all__ = ["Rearranging"]

_LIFTED = 0.012  # metres over where an object stands, from which on it is in the air
_SAME_COLUMN = 0.75  # of an object's side: distance beside another's centre within which it is over it
_LEVEL = 0.4  # of a side: by how much one that stands on another is too high or too low
_ROOM = 1.5  # sides between the centres of an object and a goal, so that fingers set one down beside the other
_ASIDE = 2.2  # sides from all goals and objects where an object is put aside
_FIRST = 1e3  # of an order: before all that differs by less


@dataclass(frozen=True)
class Scenery:
    """What is where in scenes (B,) of K objects, and who waits for whom; (B, K, K) are of the first and the second."""

    places: Tensor
    """(B, K, 3), metres."""
    goals: Tensor
    """(B, K, 3), metres."""
    settled: Tensor
    """Bool (B, K): at its goal, and on nothing that has to move."""
    lifted: Tensor
    """Bool (B, K): in the air."""
    on: Tensor
    """Bool (B, K, K): the first stands on the second, and neither is settled."""
    blocked: Tensor
    """Bool (B, K, K): the second is where the first is to go, and neither is settled."""
    above: Tensor
    """Bool (B, K, K): the first is to stand over the second, and neither is settled."""

    @property
    def waits(self) -> Tensor:
        """Bool (B, K, K): the first waits for the second."""
        return self.on.transpose(-1, -2) | self.blocked | self.above

    @property
    def waiting(self) -> Tensor:
        """Bool (B, K): it waits for another one."""
        return self.waits.any(-1)

    @property
    def to_put_aside(self) -> Tensor:
        """Bool (B, K): in a knot, and another one is under it or is to go where it is; nothing stands on it."""
        knotted = _closure(self.waits).diagonal(dim1=-2, dim2=-1)
        in_the_way = self.blocked.any(-2) | self.on.any(-1)
        return knotted & in_the_way & ~self.on.any(-2)

    def moves(self) -> Tensor:
        """Number (B,) of times that an object has to be set down still.

        One an unsettled object, and another one for each that is put aside: of a ring of objects at each other's goals,
        on top of one that it waits for, or in the air already.
        """
        in_the_air = self.lifted & self.waiting
        tops = (self.on & _closure(self.blocked | self.above)).any(-1)
        still_blocked = self.blocked & ~(self.lifted | tops).unsqueeze(-2)  # those are as good as aside
        aside = in_the_air.float().sum(-1) + tops.float().sum(-1) + _rings(_closure(still_blocked | self.above))
        return (~self.settled).float().sum(-1) + aside


@dataclass(frozen=True)
class Rearranging:
    """Objects of one size that are brought to a place each, where they may be in each other's way.

    The next one is that which is in the air; or else the one whose goal is lowest of those that wait for none; or else
    one of a knot on which nothing stands. It goes to its goal, or aside while it waits.
    """

    several: Several
    """The objects, and when they are there."""
    side: float
    """Metres: an object's height and width."""
    table: tuple[float, float, float, float]
    """Metres: lowest x and y, highest x and y where objects can be put aside."""
    spots: tuple[int, int] = (4, 5)
    """Places aside along x and y."""

    @cached_property
    def _spots(self) -> Tensor:
        """Places (S, 3) on the table."""
        x, y, to_x, to_y = self.table
        grid = torch.cartesian_prod(torch.linspace(x, to_x, self.spots[0]), torch.linspace(y, to_y, self.spots[1]))
        return torch.cat([grid, torch.full((len(grid), 1), 0.5 * self.side)], -1)

    def moves(self, points: Points, info: Info) -> Tensor:
        """How many (B,) times an object has to be set down still, at its goal or aside."""
        return self.scenery(points, info).moves()

    def of_next(self, make: Callable[[str, Place], Term]) -> Term:
        """What a term gives for the next object and the place it goes to; for the last one, where all are settled.

        Args:
            make: (name, place) -> the object's term.
        """
        terms = [make(name, self.target(name)) for name in self.several.names]

        def term(points: Points, info: Info) -> Tensor:
            values = torch.stack([each(points, info).float() for each in terms], -1)
            return values.gather(-1, self.next(points, info).unsqueeze(-1)).squeeze(-1)

        return term

    def next(self, points: Points, info: Info) -> Tensor:
        """Place (B,) of the next object among the names."""
        scenery = self.scenery(points, info)
        index = torch.arange(len(self.several.names), dtype=scenery.goals.dtype, device=scenery.goals.device)
        order = scenery.goals[..., 2] + 1e-3 * index
        order = order + _FIRST * scenery.waiting + 2.0 * _FIRST * (scenery.waiting & ~scenery.to_put_aside)
        in_hand = scenery.lifted & ~scenery.settled
        return (order + 8.0 * _FIRST * scenery.settled - 4.0 * _FIRST * in_hand).argmin(-1)

    def target(self, name: str) -> Place:
        """Where an object goes now (B, 3): its goal, or while it waits the nearest free place on the table."""
        k = self.several.names.index(name)

        def place(points: Points, info: Info) -> Tensor:
            scenery = self.scenery(points, info)
            aside = self._aside(scenery, k)
            return torch.where(scenery.waiting[..., k, None], aside, scenery.goals[..., k, :])

        return place

    def _aside(self, scenery: Scenery, k: int) -> Tensor:
        """The free place (B, 3) that is nearest to object k; the freest one, where none is free."""
        spots = self._spots.to(scenery.places)
        others = [j for j in range(len(self.several.names)) if j != k]
        taken = torch.cat([scenery.goals, scenery.places[..., others, :]], -2)[..., None, :, :2]  # (B, 1, T, 2)
        room = (spots[:, None, :2] - taken).norm(dim=-1).amin(-1)  # (B, S)
        way = (spots[:, :2] - scenery.places[..., k, None, :2]).norm(dim=-1)
        lacking = (_ASIDE * self.side - room).clamp_min(0.0)
        return spots[(way + _FIRST * lacking).argmin(-1)]

    def scenery(self, points: Points, info: Info) -> Scenery:
        """What is where, and who waits for whom."""
        return _scenery(points, self, info["goal"])


@contacts.once
def _scenery(points: Points, rules: Rearranging, goal: Tensor) -> Scenery:
    """What is where, and who waits for whom, where the goal tells the places in a row (B, 3 K)."""
    places = torch.stack([contacts.centre(points, name) for name in rules.several.names], -2)
    goals = goal.unflatten(-1, (-1, 3)).to(places).expand(places.shape)
    side = rules.side
    on = _stand_on(places, side)
    settled = _settled(rules.several.there(points, {"goal": goal}), on)
    standing = (places[..., 2] <= 0.5 * side + _LIFTED) | on.any(-1)
    gaps = (goals.unsqueeze(-2) - places.unsqueeze(-3))[..., :2].norm(dim=-1)
    columns = (goals.unsqueeze(-2) - goals.unsqueeze(-3))[..., :2].norm(dim=-1) < _SAME_COLUMN * side
    higher = goals[..., 2].unsqueeze(-1) > goals[..., 2].unsqueeze(-2) + 0.5 * side
    others = ~torch.eye(places.shape[-2], dtype=torch.bool, device=places.device)
    pairs = others & ~settled.unsqueeze(-1) & ~settled.unsqueeze(-2)
    blocked = (gaps < _ROOM * side) & pairs
    return Scenery(places, goals, settled, ~standing, on & pairs, blocked, columns & higher & pairs)


def _stand_on(places: Tensor, side: float) -> Tensor:
    """Bool (B, K, K): the first is on top of the second, of places (B, K, 3)."""
    offset = places.unsqueeze(-2) - places.unsqueeze(-3)
    beside = offset[..., :2].norm(dim=-1) < _SAME_COLUMN * side
    return beside & ((offset[..., 2] - side).abs() < _LEVEL * side)


def _settled(there: Tensor, on: Tensor) -> Tensor:
    """Those that are there (B, K), without those which stand, at whatever height, on one that is not."""
    settled = there
    for _ in range(there.shape[-1] - 1):
        settled = there & ~(on & ~settled.unsqueeze(-2)).any(-1)
    return settled


def _closure(waits: Tensor) -> Tensor:
    """Bool (B, K, K): the first waits for the second, by way of others too."""
    reach = waits
    for _ in range(max(waits.shape[-1] - 1, 1).bit_length()):
        reach = reach | ((reach.float() @ reach.float()) > 0.5)
    return reach


def _rings(reach: Tensor) -> Tensor:
    """Number (B,) of rings in a closure (B, K, K)."""
    together = (reach & reach.transpose(-1, -2)).float().sum(-1)
    return (reach.diagonal(dim1=-2, dim2=-1) / together.clamp_min(1.0)).sum(-1)
