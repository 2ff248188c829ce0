"""Policies' success in the world model against their success in the simulator."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pwm_gym.evaluation.ranking import measure_text
from pwm_gym.viewer.palette import PREDICTED, TRUE

__all__ = ["draw_ranking"]


def draw_ranking(table: Mapping[str, Any], path: Path) -> Path:
    """Draw a scatter with 95 % intervals, beside the floor where the table has one, and return ``path``.

    Args:
        table: of :func:`pwm_gym.evaluation.ranking_table`, with "task" and perhaps "floor".
        path: a PNG or an SVG.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = [("success in the world model", table, PREDICTED)]
    if "floor" in table:
        shown.append(("success in the simulator, other scenes", table["floor"], TRUE))
    figure = Figure(figsize=(4.6 * len(shown), 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    for place, (label, each, color) in enumerate(shown):
        axes = figure.add_subplot(1, len(shown), place + 1, aspect="equal")
        _scatter(axes, each, tuple(c / 255 for c in color))
        axes.set(xlabel="success in the simulator", ylabel=label, xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    figure.suptitle(f"{table['task']}: {table['policies']} policies, {table['scenes']} scenes")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    return path


def _scatter(axes: Any, table: Mapping[str, Any], color: tuple[float, ...]) -> None:
    """Points with intervals both ways, and the table's measures."""
    axes.plot([0, 1], [0, 1], color="0.8", linewidth=1, zorder=0)
    for row in table["rows"]:
        x, y = row["simulator"], row["model"]
        across, up = (
            [[value - low], [high - value]]
            for value, (low, high) in ((x, row["simulator_interval"]), (y, row["model_interval"]))
        )
        axes.errorbar(x, y, xerr=across, yerr=up, fmt="o", color=color, ecolor=(*color, 0.35), markersize=5)
    told = [f"{name} {measure_text(table[key])}" for name, key in (("r", "pearson"), ("MMRV", "mmrv"))]
    axes.set_title(", ".join(told), fontsize=10)
    axes.grid(color="0.93")
