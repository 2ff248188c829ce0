"""JSON read into typed dataclasses: every file's header passes here, so that damage ends in one clear error."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pwm_gym.errors import PwmGymError

__all__ = ["convert", "decode", "read_json"]

_T = TypeVar("_T")
_LIMIT = 64 * 2**20  # bytes; a data set's header holds a few hundred thousand numbers at most


def convert(data: Any, form: type[_T], error: type[PwmGymError], what: str) -> _T:
    """``data`` (plain JSON values) as ``form``, a dataclass or another type that it is checked against.

    Args:
        data: plain values.
        form: expected type.
        error: raised where something does not fit.
        what: what ``data`` is, for the message.
    """
    try:
        return msgspec.convert(data, form)
    except (msgspec.ValidationError, RecursionError, UnicodeError) as cause:
        raise error(f"{what}: {cause}") from cause


def decode(content: bytes | str, form: type[_T], error: type[PwmGymError], what: str) -> _T:
    """JSON text as ``form``; arguments as of :func:`convert`."""
    if len(content) > _LIMIT:
        raise error(f"{what} has {len(content)} bytes; expected at most {_LIMIT}")
    try:
        return msgspec.json.decode(content, type=form)
    except (msgspec.MsgspecError, RecursionError, UnicodeError) as cause:
        raise error(f"{what} is truncated or not valid ({cause})") from cause


def read_json(path: Path, form: type[_T], error: type[PwmGymError]) -> _T:
    """The JSON file at ``path`` as ``form``; arguments as of :func:`convert`."""
    try:
        content = path.read_bytes()
    except OSError as cause:
        raise error(f"{path} cannot be read ({cause.strerror or cause})") from cause
    return decode(content, form, error, str(path))
