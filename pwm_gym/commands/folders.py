"""Where a task's own files are, unless the command line says otherwise."""

from __future__ import annotations

from pathlib import Path

__all__ = ["data_folder", "run_folder"]


def data_folder(task: str, given: Path | None = None) -> Path:
    """Folder of a task's data set."""
    return Path("data-sets") / task if given is None else given


def run_folder(task: str, given: Path | None = None) -> Path:
    """Folder of a task's training."""
    return Path("runs") / task if given is None else given
