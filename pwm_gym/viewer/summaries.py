"""Charts of what was measured: how times grow, how errors spread, and whether a model knows its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image

from pwm_gym.viewer.chart import chart_axes, css, heading, new_figure, picture
from pwm_gym.viewer.labels import INK, MUTED
from pwm_gym.viewer.palette import PREDICTED, TRUE

__all__ = ["draw_calibration", "draw_growth", "draw_quartiles"]

_TITLE = {"x": 0.02, "ha": "left", "fontsize": 12, "color": css(INK)}
_GAP, _TITLE_ROW = 20, 60  # pixels


def draw_quartiles(panels: Mapping[str, np.ndarray], title: str, size: tuple[int, int] = (460, 300)) -> Image.Image:
    """A picture of charts side by side: the median over steps 1 to T within the band of its quartiles.

    Args:
        panels: title of a chart -> lower quartile, median and upper quartile (3, T) of one quantity.
        title: over all of them.
        size: of one chart, pixels.
    """
    width, height = size
    figure = new_figure(len(panels) * (width + _GAP) + _GAP, height + _TITLE_ROW)
    figure.suptitle(title, **_TITLE)
    for axes, (name, (low, middle, high)) in zip(chart_axes(figure, len(panels)), panels.items(), strict=True):
        steps = np.arange(1, len(middle) + 1)
        axes.fill_between(steps, low, high, color=css(PREDICTED), alpha=0.22, linewidth=0, label="quartiles")
        axes.plot(steps, middle, color=css(PREDICTED), label="median")
        axes.set_xlabel("step")
        axes.set_xlim(1, max(len(middle), 2))
        axes.set_ylim(bottom=0)
        heading(axes, name, legend=True)
    return picture(figure)


def draw_growth(
    panels: Mapping[str, Mapping[str, Mapping[float, float]]], title: str, size: tuple[int, int] = (400, 300)
) -> Image.Image:
    """A picture of charts side by side: how times grow with a size; dots are what was measured.

    Args:
        panels: name of a size -> label of a curve (two in all at most) -> size -> seconds.
        title: over all of them.
        size: of one chart, pixels.
    """
    width, height = size
    labels = list(dict.fromkeys(label for curves in panels.values() for label in curves))
    colors = dict(zip(labels, (PREDICTED, TRUE)[: len(labels)], strict=True))
    figure = new_figure(len(panels) * (width + _GAP) + _GAP, height + _TITLE_ROW)
    figure.suptitle(title, **_TITLE)
    for axes, (name, curves) in zip(chart_axes(figure, len(panels)), panels.items(), strict=True):
        for label, known in curves.items():
            sizes = sorted(known)
            axes.plot(sizes, [known[s] for s in sizes], "o-", color=css(colors[label]), markersize=4, label=label)
        axes.set_xlabel(name)
        axes.set_xticks(sorted({s for known in curves.values() for s in known}))
        axes.set_xlim(left=0)
        axes.set_ylim(0, 1.08 * max(seconds for known in curves.values() for seconds in known.values()))
        heading(axes, "seconds", legend=True)
    return picture(figure)


def draw_calibration(
    bins: Sequence[Mapping[str, float]], title: str, size: tuple[int, int] = (620, 340)
) -> Image.Image:
    """Expected and real errors in bins of the expected one, from the surest predictions to the least sure.

    Args:
        bins: each with "expected", "real_mean" and "real_median", metres; errors of 0 are not drawn.
        title: over the chart.
        size: of the chart, pixels.
    """
    width, height = size
    figure = new_figure(width + 2 * _GAP, height + _TITLE_ROW)
    figure.suptitle(title, **_TITLE)
    (axes,) = chart_axes(figure, 1)
    places = np.arange(1, len(bins) + 1)
    names = {
        "expected": ("expected", PREDICTED),
        "real_mean": ("real, mean", TRUE),
        "real_median": ("real, median", MUTED),
    }
    for key, (label, color) in names.items():
        millimetres = 1e3 * np.array([b[key] for b in bins])
        axes.plot(
            places, np.where(millimetres > 0, millimetres, np.nan), "o-", color=css(color), markersize=4, label=label
        )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.set_xlabel("bins of the expected error, surest first")
    axes.set_xticks(places)
    heading(axes, "error (mm)", legend=True)
    return picture(figure)
