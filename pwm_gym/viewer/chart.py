"""Charts by matplotlib: their look, and pictures of its figures. matplotlib is imported where a chart is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from pwm_gym.viewer.labels import INK, MUTED
from pwm_gym.viewer.palette import Color

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["RULE", "chart_axes", "css", "heading", "new_figure", "picture"]

RULE = "#dee3e7"
"""Colour of rules behind the curves."""

_DPI = 100


def css(color: Color) -> str:
    """A colour as matplotlib and pages take it, ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def new_figure(width: int, height: int) -> Figure:
    """An empty figure of so many pixels, which no window and no global state belongs to."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.1, wspace=0.03)
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def chart_axes(figure: Figure, count: int) -> list[Axes]:
    """``count`` charts side by side, in the house's look: faint rules, no box, quiet ticks."""
    found = figure.subplots(1, count, squeeze=False)[0]
    for axes in found:
        axes.grid(axis="y", color=RULE, linewidth=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.spines["bottom"].set_color(css(MUTED))
        axes.tick_params(colors=css(MUTED), labelsize=8, left=False)
        axes.xaxis.label.set(color=css(MUTED), size=8)
        axes.yaxis.label.set(color=css(MUTED), size=8)
    return list(found)


def heading(axes: Axes, title: str, legend: bool) -> None:
    """A chart's title at its left and, where asked for, the curves' names at its right."""
    axes.set_title(title, loc="left", color=css(INK), size=10)
    if legend:
        names = axes.legend(
            frameon=False, fontsize=8, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.99), borderaxespad=0.2
        )
        for line in names.get_lines():  # also of curves that are faint in the chart
            line.set_alpha(1.0)


def picture(figure: Figure, drawn: bool = False) -> Image.Image:
    """The figure as an RGB image.

    Args:
        figure: of :func:`new_figure`.
        drawn: whether its canvas shows it already.
    """
    canvas: Any = figure.canvas
    if not drawn:
        canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
