"""What damaged files, kills and long runs did: a section of the results page."""

from __future__ import annotations

from typing import Any

from formatting import grid, number, paragraph, read, source


def reliability() -> str:
    """The section; empty where nothing was measured."""
    parts = {"fuzz": _fuzz, "kills": _kills, "soak": _soak}
    found = {name: result for name in parts if (result := read(name)) is not None}
    if not found:
        return ""
    told = "\n".join(f"{parts[name](result)}\n{source(name, result)}" for name, result in found.items())
    return f"## Reliability\n\n{told}"


def _fuzz(result: dict[str, Any]) -> str:
    kinds = result["kinds"]
    slowest = max(kind["slowest_seconds"] for kind in kinds.values())
    return paragraph(
        f"Damaged files of {len(kinds)} kinds that the package reads (checkpoints, data sets, scenes, frames, meshes",
        f"and others): of {result['files']:,}, {result['refused']:,} ended in one clear error, which names the file,",
        f"{result['failed']:,} in anything else; the rest were read. The slowest took {slowest:.1f} s, and memory",
        f"reached {result['peak_gib']:.1f} GiB.",
    )


def _kills(result: dict[str, Any]) -> str:
    rows = [
        [f"`{name}`", str(row["kills"]), number(row["seconds"], 0), str(len(row["faults"]))]
        for name, row in result["commands"].items()
    ]
    about = paragraph(
        "Long commands killed (`kill -9`) at random moments and started again, until they end: a fault is a finished",
        "file that was touched, a spoilt one, or another result than an undisturbed run's.",
    )
    return f"{about}\n{grid(['command', 'kills', 'seconds of an undisturbed run', 'faults'], rows)}"


def _soak(result: dict[str, Any]) -> str:
    rows = [
        [
            name,
            f"{row['steps']:,}",
            number(row["start_mib"], 0),
            number(row["end_mib"], 0),
            f"{row['slope_mib']:+.1f}".replace("-0.0", "+0.0"),
        ]
        for name, row in result["subjects"].items()
    ]
    about = paragraph(f"{result['steps']:,} vector steps of {result['num_envs']} environments: resident memory.")
    head = ["environments", "steps", "MiB at the start", "at the end", "trend, MiB in 100,000 steps"]
    return f"{about}\n{grid(head, rows)}"
