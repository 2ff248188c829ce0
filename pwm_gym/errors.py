"""Errors that name the offending value and what was expected."""

from __future__ import annotations

import difflib
import math
import numbers
import operator
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

__all__ = [
    "CheckpointError",
    "DatasetError",
    "PwmGymError",
    "SceneError",
    "UnknownEntityError",
    "UnknownNameError",
    "WriteError",
    "check_seed",
    "check_whole",
    "is_number",
    "look_up",
    "unknown_name",
    "writing",
]


_Value = TypeVar("_Value")


class PwmGymError(ValueError):
    """Base class of the package's errors about bad input."""


class SceneError(PwmGymError):
    """A scene does not fit the task: entities, point counts, poses or goal."""


class CheckpointError(PwmGymError):
    """A checkpoint is truncated, foreign, of another task or of a newer schema."""


class DatasetError(PwmGymError):
    """A data set is truncated, foreign or of another task."""


class UnknownNameError(PwmGymError):
    """A name that no registry holds."""


class UnknownEntityError(UnknownNameError, KeyError):
    """An entity that a scene has not."""

    __str__ = ValueError.__str__  # not KeyError's, which quotes the message


class WriteError(PwmGymError, OSError):
    """A file cannot be written: the disk is full, or the folder may not be written to."""


@contextmanager
def writing(path: Path, *also: type[Exception]) -> Iterator[None]:
    """What the system says against writing ``path`` (no space, no permission) as one error that names it.

    Args:
        path: file or folder.
        also: what a library raises in the system's place.

    Raises:
        WriteError: in the place of all of these.
    """
    caught: tuple[type[Exception], ...] = (OSError, *also)
    try:
        yield
    except WriteError:
        raise
    except caught as cause:
        told = getattr(cause, "strerror", None) or cause
        raise WriteError(f"{path} cannot be written ({told})") from cause


def unknown_name(kind: str, name: Any, known: Iterable[str]) -> UnknownNameError:
    """Error for an unregistered ``name``: lists the ``known`` ones and suggests the nearest.

    Example:
        >>> print(unknown_name("cost", "pick_cub", ["pick_cube", "pick_cube_paper"]))
        unknown cost 'pick_cub'; known: pick_cube, pick_cube_paper. Did you mean 'pick_cube'?
    """
    names = sorted(known)
    near = difflib.get_close_matches(str(name), names, n=1)
    hint = f" Did you mean '{near[0]}'?" if near else ""
    return UnknownNameError(f"unknown {kind} {name!r}; known: {', '.join(names) or 'none'}.{hint}")


def look_up(kind: str, name: Any, known: Mapping[str, _Value]) -> _Value:
    """What ``known`` holds under ``name``.

    Raises:
        UnknownNameError: as of :func:`unknown_name`.
    """
    if not isinstance(name, str) or name not in known:
        raise unknown_name(kind, name, known)
    return known[name]


def check_whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """``value``, a whole number from ``least`` to ``most``, or of any size where there is no ``most``.

    Raises:
        PwmGymError: it is none, less, or more.
    """
    number = _whole(value)
    if number is None or number < least or (most is not None and number > most):
        wanted = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise PwmGymError(f"{name}={value!r}; expected a whole number {wanted}")
    return number


def is_number(value: Any) -> bool:
    """Whether ``value`` is a real number and no NaN, NumPy's included."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool) and not math.isnan(value)


def check_seed(value: Any) -> int:
    """``value``, a seed.

    Raises:
        PwmGymError: it is no whole number from 0 to 2**63 - 1.
    """
    number = _whole(value)
    if number is None or not 0 <= number < 2**63:
        raise PwmGymError(f"seed={value!r}; expected a whole number from 0 to 2**63 - 1")
    return number


def _whole(value: Any) -> int | None:
    """A whole number, NumPy's included, as Python's; None where it is something else."""
    if isinstance(value, bool):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None
