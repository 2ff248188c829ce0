"""What the JSON in ``benchmarks/results`` says of a task: found by the commands that made it, no file is named here."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

from formatting import RESULTS, number, success

_DEFAULT_TASK = "PickCube"  # of commands that name none
PAPER_SUCCESS = {
    "PickCube": 90,
    "StackCube": 75,
    "PickYCB": 65,
    "MugCleanup": 75,
    "Coffee": 60,
    "CoffeePreparation": 45,
}
"""Success in closed loop that the paper reports, percent; its episodes, objects and simulator are others."""
PAPER_ROLLOUTS = {
    "PickCube": (0.009, 0.86),
    "StackCube": (0.014, 0.83),
    "PickYCB": (0.028, 0.85),
    "MugCleanup": (0.022, 0.79),
    "TwoArmBoxCleanup": (0.022, 0.83),
    "TwoArmDrawerCleanup": (0.058, 0.77),
}
"""Chamfer L1 (m) and reward correlation of the paper's rollouts; likewise."""


@dataclass(frozen=True)
class Measurement:
    """One JSON file and what its command line says."""

    name: str
    """File name without its ending."""
    result: dict[str, Any]
    """The file's content."""

    @cached_property
    def options(self) -> dict[str, list[str]]:
        """Option of the command -> its values."""
        found: dict[str, list[str]] = {}
        values: list[str] = []
        for word in shlex.split(self.result["command"]):
            if word.startswith("--"):
                values = found.setdefault(word[2:], [])
            else:
                values.append(word)
        return found

    @property
    def verb(self) -> str:
        """What the command does: "plan", "evaluate", "bench", ..."""
        return self.result["command"].split()[1]

    @property
    def task(self) -> str:
        """Task that was measured."""
        return self.options.get("task", [_DEFAULT_TASK])[0]

    @property
    def objects(self) -> str:
        """Set of objects that the command or its data set names, if any."""
        data = self.options.get("data", [""])[0]
        return self.options.get("objects", [data.partition("-unseen")[1].strip("-")])[0]

    @property
    def starts(self) -> str:
        """Where the episodes started, if the command names it."""
        return self.options.get("starts", [""])[0]

    @property
    def shipped(self) -> bool:
        """Whether it is of a shipped checkpoint, which has a name and is no folder."""
        return "/" not in self.options.get("checkpoint", [""])[0]


def measurements(verb: str, task: str | None = None) -> list[Measurement]:
    """Results of ``pwm-gym VERB`` and the shipped checkpoints, of one task or of all.

    Tables of trainings and views of a camera are left out.
    """
    asked = [m for m in _all() if m.verb == verb and task in (None, m.task) and m.shipped]
    return asked if verb == "bench" else [m for m in asked if not {"table", "completer"} & m.options.keys()]


@cache
def _all() -> list[Measurement]:
    """Every result, read once."""
    return [Measurement(path.stem, json.loads(path.read_text())) for path in sorted(RESULTS.glob("*.json"))]


def plan_label(measurement: Measurement) -> str:
    """How the episodes of a planning result were planned."""
    result = measurement.result
    chunk = result["chunk"]
    parts = [{0: "open loop", 1: "closed loop"}.get(chunk, f"chunks of {chunk}")]
    if result["observation"] != "complete":
        parts.append(f"{result['observation']} clouds")
    if measurement.objects:
        parts.append(f"{measurement.objects} objects")
    if measurement.starts == "play":
        parts.append("starts in play")
    if "guide" in result:
        parts.append("plans start from a policy's")
    return ", ".join(parts)


def plan_cells(measurement: Measurement) -> list[str]:
    """Label and figures of a planning result."""
    return [plan_label(measurement), *success(measurement.result)]


def rollout_rows(measurement: Measurement) -> list[list[str]]:
    """Cells of each split of a rollout result: episodes, Chamfer, correlation, objects, the linear response."""
    told = f", {measurement.objects} objects" if measurement.objects else ""
    rows = []
    for split, row in measurement.result["rows"]["compact"].items():
        linear = measurement.result["rows"].get("linear", {}).get(split)
        cells = [f"{split}{told} ({row['episodes']})", number(row["chamfer_l1"], 4)]
        cells += [number(row["reward_correlation"], 3), objects_at_60(measurement, row)]
        rows.append([*cells, number(linear["chamfer_l1"], 4) if linear else "-"])
    return rows


def objects_at_60(measurement: Measurement, row: dict[str, Any]) -> str:
    """Position error at step 60 of each object that contact moves, mean / median in millimetres."""
    cells = []
    for name in measurement.result.get("objects") or []:
        position = row["entities"].get(name, {}).get("position_mm", {}).get("60")
        if position:
            cells.append(f"`{name}` {position['mean']:.1f} / {position['median']:.1f}")
    return ", ".join(cells) or "-"


def commands(found: list[Measurement]) -> str:
    """The commands that made them, as a block."""
    return "```\n" + "\n".join(m.result["command"] for m in found) + "\n```\n"
