"""Disjoint ranges of simulator seeds, fixed in this one place.

A seed's range tells what it may be used for, so that nothing is evaluated on what it was trained on.
"""

from __future__ import annotations

from pwm_gym.errors import PwmGymError

__all__ = ["RANGES", "seed_range", "split_of"]

_SPAN = 100_000
_NAMES = ("train", "validation", "test", "plan_validation", "plan_test")

RANGES: dict[str, range] = {name: range(i * _SPAN, (i + 1) * _SPAN) for i, name in enumerate(_NAMES)}
"""Split -> its seeds. The scene bank is drawn from ``train``; planners are tuned on ``plan_validation``."""


def seed_range(split: str, count: int, offset: int = 0) -> range:
    """First ``count`` seeds of ``split`` after ``offset``.

    Raises:
        PwmGymError: a negative number, or more than there are.
    """
    seeds = RANGES[split]
    if min(count, offset) < 0 or offset + count > len(seeds):
        raise PwmGymError(f"{split} has {len(seeds)} seeds; {offset} + {count} were asked for")
    return seeds[offset : offset + count]


def split_of(seed: int) -> str:
    """Name of the range that holds ``seed``."""
    for name, seeds in RANGES.items():
        if seed in seeds:
            return name
    raise ValueError(f"seed {seed} lies in none of the ranges {RANGES}")
