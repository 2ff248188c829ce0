"""Weighted sums of costs as text, such as ``0.7 * reach + 0.3 * place``."""

from __future__ import annotations

import re

from pwm_gym.errors import PwmGymError

__all__ = ["is_sum", "parse_sum"]

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PART = re.compile(rf"(?:(?P<weight>{_NUMBER})\s*\*\s*)?(?P<name>[A-Za-z_][\w.:-]*)")
_PLUS = re.compile(r"\s\+\s")


def is_sum(text: str) -> bool:
    """Whether a text is meant as a sum or a product."""
    return "*" in text or bool(_PLUS.search(text))


def parse_sum(text: str) -> list[tuple[float, str]]:
    """Weight and name of each part of a sum; a part without a weight counts once.

    Raises:
        PwmGymError: naming the part that cannot be read.

    Example:
        >>> parse_sum("0.7 * reach + place")
        [(0.7, 'reach'), (1.0, 'place')]
    """
    parts = []
    for part in _PLUS.split(text):
        found = _PART.fullmatch(part.strip())
        if found is None:
            raise PwmGymError(f"cost {text!r}: cannot read {part.strip()!r}; expected e.g. '0.7 * reach + 0.3 * place'")
        parts.append((float(found["weight"] or 1.0), found["name"]))
    return parts
