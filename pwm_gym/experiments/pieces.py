"""What every table is made of: pieces that keep their results in files, so that a killed run goes on where it was."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pwm_gym.errors import PwmGymError, writing
from pwm_gym.evaluation.record import describe_commit
from pwm_gym.files import write_atomically
from pwm_gym.workers import Workers, work_through

__all__ = ["Piece", "run_pieces"]


@dataclass(frozen=True)
class Piece:
    """One result of a table, and how to make it."""

    label: str
    """Row, seed or mode: how the progress names it."""
    kind: str
    """First part of its folder's name."""
    recipe: str
    """All that decides the result: tables share pieces of one recipe, and a changed one is a new piece."""
    out: Path
    """Folder of all pieces."""
    make: Callable[[Path], dict[str, Any]]
    """Makes the result (JSON values), given the piece's folder for what it keeps beside; picklable."""

    @property
    def folder(self) -> Path:
        """Folder of the piece, named after its recipe."""
        return self.out / f"{self.kind}-{hashlib.sha256(self.recipe.encode()).hexdigest()[:12]}"

    @property
    def result(self) -> Path:
        """File of the result."""
        return self.folder / "result.json"

    def read(self) -> dict[str, Any]:
        """The result.

        Raises:
            PwmGymError: the file is missing or damaged.
        """
        try:
            found = json.loads(self.result.read_text())
        except (OSError, ValueError, RecursionError) as error:
            raise PwmGymError(f"{self.result} is no result ({error}); delete it to make it again") from error
        return dict(found)


def run_pieces(
    pieces: Sequence[Piece], workers: int | Workers = 1, tell: Callable[[str], None] = print
) -> list[dict[str, Any]]:
    """Make what is missing, and return every piece's result.

    Args:
        pieces: of the table; those that share a recipe are made once.
        workers: pieces at once, each in a process of its own where there are several, or who makes them.
        tell: is given one line a finished piece, with the time that it took.

    Raises:
        PwmGymError: a process died, or a result that was there is damaged.
    """
    commit = describe_commit()  # of the code that is loaded, which may change on disk meanwhile
    missing = list({p.folder: (p, commit) for p in pieces if not p.result.exists()}.values())
    if missing:
        with writing(missing[0][0].out):  # before anything is made that could not be kept
            missing[0][0].out.mkdir(parents=True, exist_ok=True)
        kept = len({p.folder for p in pieces}) - len(missing)
        tell(f"{len(missing)} pieces to make, {kept} there already, in {missing[0][0].out}")
    for count, (label, seconds) in enumerate(work_through(_make, missing, workers), 1):
        tell(f"[{count}/{len(missing)}] {label}: {_clock(seconds)}")
    return [piece.read() for piece in pieces]


def _make(job: tuple[Piece, str | None]) -> tuple[str, float]:
    piece, commit = job
    begun = time.perf_counter()
    result = {"commit": commit, **piece.make(piece.folder)}
    write_atomically(piece.result, json.dumps(result, default=float).encode())
    return piece.label, time.perf_counter() - begun


def _clock(seconds: float) -> str:
    """Seconds in words."""
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60:.1f} min"
