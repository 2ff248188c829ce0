"""Strings in the infos of a batch, which wrappers that convert arrays hand on as they are."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from pwm_gym.scene import Scene

__all__ = ["TextArray", "text_array"]


class TextArray(np.ndarray):
    """Strings (B,) of an info, dtype object.

    No other array library has strings: Gymnasium's ``NumpyToTorch`` and its kin leave this type alone.
    """


def text_array(strings: Sequence[str]) -> TextArray:
    """``strings`` as an array (B,)."""
    return np.array(strings, dtype=object).view(TextArray)


def _unchanged(value: Any, xp: ModuleType, device: Any = None) -> Any:
    return value


# Gymnasium converts by type, and its wrappers need array_api_compat: where it is missing, there is nothing to tell.
with contextlib.suppress(ImportError, DependencyNotInstalled):
    from gymnasium.wrappers.array_conversion import array_conversion

    array_conversion.register(TextArray, _unchanged)
    array_conversion.register(Scene, _unchanged)  # of reset(options={"scene": scene})
