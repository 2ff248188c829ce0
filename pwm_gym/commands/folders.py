"""Where a task's own files are, unless the command line says otherwise, and whether results can be written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pwm_gym.errors import WriteError, writing

__all__ = ["check_outputs", "data_folder", "run_folder"]

_FILES, _FOLDERS = ("json", "picture", "video", "html", "gif", "mp4"), ("pictures", "strips")
"""A command's options that name what it writes at its end."""


def check_outputs(command: Any) -> None:
    """Refuse at once what a command could not write after hours.

    Raises:
        WriteError: naming the file or folder.
    """
    chosen = getattr(command, "action", command)  # of a command with commands of its own
    for name in (*_FILES, *_FOLDERS):
        path = getattr(chosen, name, None)
        if not isinstance(path, Path):
            continue
        if name in _FILES and path.is_dir():
            raise WriteError(f"{path} cannot be written (it is a folder)")
        folder = path.parent if name in _FILES else path
        with writing(path):
            folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise WriteError(f"{path} cannot be written ({folder} is read-only)")


def data_folder(task: str, given: Path | None = None) -> Path:
    """Folder of a task's data set."""
    return Path("data-sets") / task if given is None else given


def run_folder(task: str, given: Path | None = None) -> Path:
    """Folder of a task's training."""
    return Path("runs") / task if given is None else given
