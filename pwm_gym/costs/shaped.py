"""How simulators' shaped rewards are put together from terms: bonuses, and stages that replace each other."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from pwm_gym.costs.contacts import Points
from pwm_gym.costs.terms import Info, Term

__all__ = ["bring", "let_go", "normalised", "stages", "success_bonus"]


def bring(reach: Term, held: Term, placed: Term) -> Term:
    """Reward for reaching an object (up to 1), holding it (1 more) and bringing it to its place (1 more)."""
    return lambda points, info: reach(points, info) + held(points, info) * (1.0 + placed(points, info))


def let_go(held: Term, then: Term) -> Term:
    """What ``then`` gives, where an object is not held any more."""
    return lambda points, info: ~held(points, info) * then(points, info)


def normalised(
    whole: float, parts: Mapping[str, tuple[Term | None, float, Term]], success: Term
) -> dict[str, tuple[float, Term]]:
    """Weighted terms of minus a staged reward over its greatest value; -1 at success.

    Args:
        whole: the reward at success.
        parts: name -> rule from which on it counts (None: always), what it begins at, and what it adds to that.
        success: the success rule.
    """

    def share(base: float, term: Term) -> Term:
        return lambda points, info: -(base + term(points, info)) / whole

    counted = {name: (rule, share(base, term)) for name, (rule, base, term) in parts.items()}
    return stages({**counted, "success": (success, lambda points, info: -success(points, info).float())})


def success_bonus(success: Term, whole: float, parts: list[Term]) -> Term:
    """What success adds to the sum of ``parts``, so that it is ``whole`` there."""

    def term(points: Points, info: Info) -> Tensor:
        first, *others = (part(points, info) for part in parts)
        total = sum(others, first)
        return (whole - total) * success(points, info)

    return term


def stages(parts: Mapping[str, tuple[Term | None, Term]]) -> dict[str, tuple[float, Term]]:
    """Weighted terms of a reward whose stages replace each other: only the last stage whose rule holds counts.

    Args:
        parts: name -> rule (None: always) and term, the earliest stage first.
    """
    rules = [rule for rule, _ in parts.values()]

    def only(term: Term, later: list[Term | None], rule: Term | None) -> Term:
        def staged(points: Points, info: Info) -> Tensor:
            value = term(points, info)
            if rule is not None:
                value = torch.where(rule(points, info), value, 0.0)
            for other in later:
                assert other is not None
                value = torch.where(other(points, info), 0.0, value)
            return value

        return staged

    return {name: (1.0, only(term, rules[i + 1 :], rule)) for i, (name, (rule, term)) in enumerate(parts.items())}
