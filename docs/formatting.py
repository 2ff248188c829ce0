"""How figures are read and written: what the generators of pages share."""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
SUCCESS_HEAD = ["", "successes", "95 % interval", "mean steps of successes", "seconds an action, median"]


def read(name: str) -> dict[str, Any] | None:
    """A benchmark's result, if it is there."""
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text()) if path.exists() else None


def source(name: str, result: dict[str, Any]) -> str:
    """Command, file, machine and commit of a result."""
    machine = result["machine"]
    where = machine["gpu"] or f"{machine['cores']} CPU cores"
    link = f"[`{name}.json`](../benchmarks/results/{name}.json)"
    return f"```\n{result['command']}\n```\n\n{link}, {where}, commit {result['commit']}.\n"


def paragraph(*sentences: str) -> str:
    """Sentences in lines."""
    return textwrap.fill(" ".join(sentences), 118) + "\n"


def grid(head: list[str], rows: list[list[str]]) -> str:
    """A table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def section(title: str, sources: list[str], about: str, head: list[str], rows: list[list[str]]) -> str:
    """A section of several results: their sources, what is told about them, and one table; nothing without rows."""
    if not rows:
        return ""
    told = "\n".join(sources)
    return f"## {title}\n\n{told}\n{about}\n{grid(head, rows)}"


def number(value: float | None, digits: int) -> str:
    """A number, or a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def success(result: dict[str, Any]) -> list[str]:
    """Cells of a planning result, as :data:`SUCCESS_HEAD` names them behind its first."""
    low, high = result["interval"]
    held = result.get("successes_at_the_end")
    return [
        f"{result['successes']} / {result['episodes']}" + ("" if held is None else f", {held} at the last step"),
        f"{low:.0%} to {high:.0%}",
        number(result["mean_steps_of_successes"], 0),
        f"{result['plan_seconds']['median']:.2f}",
    ]
