"""Files of arrays with a JSON header: no pickles, and no half of one where a process is killed."""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError

__all__ = ["load_arrays", "save_arrays", "write_atomically"]


def write_atomically(path: Path, content: bytes) -> None:
    """Write ``path`` so that it either holds all of ``content`` or is left as it was."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with temporary.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def save_arrays(path: str | Path, arrays: Mapping[str, np.ndarray], header: Mapping[str, Any] | None = None) -> None:
    """Write arrays, and a header if there is one, to an ``.npz`` file."""
    named: dict[str, Any] = dict(arrays)
    if header is not None:
        named["header"] = np.array(json.dumps(header))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **named)
    write_atomically(Path(path), buffer.getvalue())


def load_arrays(
    path: str | Path, complaint: str, error: type[PwmGymError], form: str | None = None
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and header of a file that :func:`save_arrays` wrote.

    Args:
        path: the file.
        complaint: what is said of a file that is missing, truncated or no ``.npz``: "is not a scene file".
        error: raised then, and where the format is another.
        form: ``header["format"]`` that it must have; None expects no header.
    """
    header: dict[str, Any] = {}
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if form is not None:
            header = dict(json.loads(str(arrays.pop("header"))))
    except (KeyError, TypeError, ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as cause:
        raise error(f"{path} {complaint} ({cause})") from cause
    if form is not None and header.get("format") != form:
        raise error(f"{path} has format {header.get('format')!r}; expected {form!r}")
    return arrays, header
