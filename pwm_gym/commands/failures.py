"""Pictures of planned episodes that failed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pwm_gym.planning import Run

__all__ = ["draw_failures"]


def draw_failures(pictures: Path, row: str, mode: str, runs: Sequence[Run]) -> str:
    """One sheet of failed runs; returns its path in the folder of pictures.

    Runs by a cost in stages are in the order of the stages that they ended in, which are told.

    Args:
        pictures: folder.
        row: what planned.
        mode: how, such as "closed loop".
        runs: the failed ones.
    """
    from pwm_gym.commands.view import twin_record
    from pwm_gym.viewer import draw_overlays

    records = []
    for run in sorted(runs, key=_reached):
        record = twin_record(run, "")
        real, foretold = run.rewards[-1], run.predicted_rewards[-1]
        ended = f"in {run.stages[-1]!r}" if run.stages else f"at reward {real:.2f}, foretold {foretold:.2f}"
        records.append(replace(record, subtitle=f"seed {run.seed}: {ended} after {run.steps} steps"))
    name = re.sub(r"[^a-z0-9]+", "-", f"{row} {mode}".lower())
    path = Path("failures") / f"{name}.png"
    (pictures / path).parent.mkdir(parents=True, exist_ok=True)
    sheet = draw_overlays(records, f"{row}, {mode}: failed episodes, the world model over the simulator")
    sheet.save(pictures / path, optimize=True)
    return str(path)


def _reached(run: Run) -> int:
    """Place of the stage that a run ended in."""
    return run.settings["stages"].index(run.stages[-1]) if run.stages else 0
