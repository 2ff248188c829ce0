"""Terms of several objects that are brought to a place each, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.terms import Info, Place, Term

__all__ = ["Several"]


@dataclass(frozen=True)
class Several:
    """Objects and when they are at their places; the goal tells the places in a row (B, 3 K).

    The next one is that of those which are not there whose place is lowest, so that what is under another comes first.
    """

    names: tuple[str, ...]
    radius: float
    """Distance in metres from an object's place within which it is there."""

    def target(self, name: str) -> Place:
        """Where an object shall be (B, 3)."""
        start = 3 * self.names.index(name)
        return lambda points, info: info["goal"][..., start : start + 3]

    def there(self, points: Points, info: Info) -> Tensor:
        """Which of the objects are at their places: bool (B, K)."""
        places = torch.stack([contacts.centre(points, name) for name in self.names], -2)
        return (places - info["goal"].unflatten(-1, (-1, 3))).norm(dim=-1) <= self.radius

    def all_there(self, points: Points, info: Info) -> Tensor:
        """Bool (B,): each object is at its place."""
        return self.there(points, info).all(-1)

    def left(self, points: Points, info: Info) -> Tensor:
        """How many (B,) objects are not at their places."""
        return (~self.there(points, info)).float().sum(-1)

    def of_next(self, make: Callable[[str], Term]) -> Term:
        """What a term gives for the next object; for the last one, where all are there.

        Args:
            make: name -> the object's term.
        """
        terms = [make(name) for name in self.names]
        if len(terms) == 1:
            return terms[0]

        def term(points: Points, info: Info) -> Tensor:
            values = torch.stack([each(points, info).float() for each in terms], -1)
            return values.gather(-1, self._next(points, info).unsqueeze(-1)).squeeze(-1)

        return term

    def any_of(self, make: Callable[[str], Term]) -> Term:
        """Bool (B,): some object fulfils a rule.

        Args:
            make: name -> the object's rule.
        """
        rules = [make(name) for name in self.names]
        return lambda points, info: torch.stack([rule(points, info) for rule in rules], -1).any(-1)

    def _next(self, points: Points, info: Info) -> Tensor:
        """Place (B,) of the next object among the names."""
        heights = info["goal"].unflatten(-1, (-1, 3))[..., 2]
        order = heights + 1e-3 * torch.arange(len(self.names), dtype=heights.dtype, device=heights.device)
        return (order + 10.0 * self.there(points, info)).argmin(-1)
