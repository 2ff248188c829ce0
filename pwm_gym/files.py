"""Files of arrays with a JSON header: no pickles, and no half of one where a process is killed."""

from __future__ import annotations

import glob
import io
import json
import os
import shutil
import struct
import time
import tokenize
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar
from uuid import uuid4

import numpy as np

from pwm_gym.errors import PwmGymError, writing
from pwm_gym.schema import decode

__all__ = [
    "NoHeader",
    "check_finite",
    "load_array",
    "load_arrays",
    "new_folder",
    "replacing",
    "save_arrays",
    "write_atomically",
]

_STALE = 3600.0  # seconds after which nobody writes a temporary file any more


def write_atomically(path: Path, content: bytes) -> None:
    """Write ``path`` so that it either holds all of ``content`` or is left as it was.

    Raises:
        WriteError: the disk is full, or the folder may not be written to.
    """
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def replacing(path: Path, *also: type[Exception]) -> Iterator[Path]:
    """A file to write beside ``path``, whose place it takes at the end: there is all of it, or what was there before.

    Each call has a file of its own, so that several processes, of several machines, may write ``path`` at once; what a
    killed one left is cleared away after an hour.

    Args:
        path: what is replaced; its folder is made.
        also: what a library raises in the system's place.

    Raises:
        WriteError: the disk is full, or the folder may not be written to.
    """
    temporary = path.with_name(f".{path.name}.{uuid4().hex[:12]}")
    with writing(path, *also):
        path.parent.mkdir(parents=True, exist_ok=True)
        _clear(path)
        try:
            yield temporary
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


def _clear(path: Path) -> None:
    """Remove what processes that were killed left of ``path``."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*"):
        with suppress(FileNotFoundError):  # another process clears, too
            if time.time() - left.stat().st_mtime > _STALE:
                left.unlink()


@contextmanager
def new_folder(folder: Path, error: type[PwmGymError]) -> Iterator[Path]:
    """A folder to fill, which becomes ``folder`` at the end, so that there is all of it or nothing.

    Args:
        folder: where it will be; an empty folder is replaced.
        error: raised where ``folder`` holds something.

    Raises:
        WriteError: something in it cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise error(f"{folder} holds something already; expected a new folder")
    temporary = folder.with_name(f".{folder.name}.{os.getpid()}")
    try:
        with writing(folder):
            temporary.mkdir(parents=True)
            yield temporary
            if folder.exists():
                folder.rmdir()
            temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def save_arrays(path: str | Path, arrays: Mapping[str, np.ndarray], header: Mapping[str, Any] | None = None) -> None:
    """Write arrays, and a header if there is one, to an ``.npz`` file."""
    named: dict[str, Any] = dict(arrays)
    if header is not None:
        named["header"] = np.array(json.dumps(header))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **named)
    write_atomically(Path(path), buffer.getvalue())


@dataclass(frozen=True)
class NoHeader:
    """Of files that hold arrays alone."""

    format: str = ""


class _Header(Protocol):
    @property
    def format(self) -> str: ...


_H = TypeVar("_H", bound=_Header)
_NUMBERS = "fiub"  # kinds of NumPy types: floats, integers, bool
_DAMAGE = (
    KeyError,
    TypeError,
    ValueError,
    OSError,
    EOFError,
    MemoryError,
    RuntimeError,
    NotImplementedError,
    OverflowError,
    SyntaxError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What NumPy and the standard library raise on damaged files."""


def load_arrays(
    path: str | Path,
    complaint: str,
    error: type[PwmGymError],
    form: str = "",
    header: type[_H] = NoHeader,  # type: ignore[assignment]
    gaps: Collection[str] | None = (),
) -> tuple[dict[str, np.ndarray], _H]:
    """Arrays and header of a file that :func:`save_arrays` wrote.

    Args:
        path: the file.
        complaint: what is said of a file that is missing, truncated or no ``.npz``: "is not a scene file".
        error: raised then, where the format is another, and where an array holds values that are not finite.
        form: the ``format`` that its header must have; empty expects no header.
        header: dataclass of the header.
        gaps: names of arrays that may hold values which are not finite; None where the caller checks them all.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except _DAMAGE as cause:
        raise error(f"{path} {complaint} ({cause})") from cause
    found: Any = NoHeader()
    if form:
        if "header" not in arrays:
            raise error(f"{path} {complaint} (it has no header)")
        text = str(arrays.pop("header"))
        named = decode(text, NoHeader, error, f"{path} {complaint}: its header")
        if named.format != form:
            raise error(f"{path} has format {named.format!r}; expected {form!r}")
        found = decode(text, header, error, f"the header of {path}")
    for name, array in arrays.items():
        if array.dtype.kind not in _NUMBERS:
            raise error(f"{path}: {name} has type {array.dtype}; expected numbers")
        if gaps is not None and name not in gaps:
            check_finite(array, f"{path}: {name}", error)
    return arrays, found


def load_array(path: str | Path, error: type[PwmGymError]) -> np.ndarray:
    """The numbers of a ``.npy`` file; ``error`` is raised where it holds none."""
    try:
        array = np.load(path, allow_pickle=False)
    except _DAMAGE as cause:
        raise error(f"{path} is not an array ({cause})") from cause
    if not isinstance(array, np.ndarray) or array.dtype.kind not in _NUMBERS:
        found = array.dtype if isinstance(array, np.ndarray) else "an archive"
        raise error(f"{path} is {found}; expected an array of numbers")
    return array


def check_finite(array: np.ndarray, what: str, error: type[PwmGymError]) -> None:
    """Raise ``error`` where an array of floats holds a NaN or an infinity."""
    if np.issubdtype(array.dtype, np.floating) and not np.isfinite(array).all():
        raise error(f"{what} holds {int((~np.isfinite(array)).sum())} values that are not finite")
