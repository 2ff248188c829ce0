"""Errors and rewards of one episode over its steps, with a cursor that moves along."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from pwm_gym.viewer.chart import RULE, chart_axes, css, heading, new_figure, picture
from pwm_gym.viewer.labels import MUTED
from pwm_gym.viewer.palette import Color

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

__all__ = ["Curve", "Panel", "Timeline"]

_FAINT = 0.28  # strength of what the cursor has not reached
_POINTS_AN_INCH = 72  # an SVG's unit


@dataclass(frozen=True, eq=False)
class Curve:
    """Values (T,) over steps 0 to T - 1."""

    label: str
    values: np.ndarray
    color: Color


@dataclass(frozen=True, eq=False)
class Panel:
    """One chart."""

    title: str
    """Told above it, with the unit where there is one."""
    curves: tuple[Curve, ...]
    """Of one length."""
    unit: str = ""
    """Unit of the first curve's value, which then stands beside the title; empty shows no value."""
    from_zero: bool = False
    """Whether the axis starts at 0."""


class Timeline:
    """Charts side by side over the same steps.

    Args:
        panels: at least one, whose curves have one length.
        width: of the picture, pixels.
        height: of the picture, pixels.
    """

    def __init__(self, panels: Sequence[Panel], width: int, height: int) -> None:
        self.panels = tuple(panels)
        self.last = max(len(panels[0].curves[0].values) - 1, 1)
        self._size = width, height

    def marked(self, steps: Sequence[int]) -> Image.Image:
        """The whole curves, with a rule and dots at ``steps``."""
        figure, charts = self._figure()
        chosen = list(steps)
        for axes, panel in zip(charts, self.panels, strict=True):
            for step in chosen:
                axes.axvline(step, color=RULE, linewidth=1, zorder=0.5)
            for curve in panel.curves:
                _dots(axes, chosen, curve.values[chosen], curve.color)
        return picture(figure)

    def frames(self) -> Frames:
        """Pictures of one step each."""
        return Frames(self)

    def svg(self) -> tuple[str, list[list[float]]]:
        """The whole curves as an ``<svg>`` element, and each chart's left, right, top and bottom in its units."""
        import matplotlib

        figure, charts = self._figure()
        nothing: dict[str, Any] = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        file = io.StringIO()
        with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "pwm_gym"}):
            figure.savefig(file, format="svg", metadata=nothing)
        drawn = file.getvalue()
        scale = _POINTS_AN_INCH / figure.dpi
        boxes = [axes.bbox.extents * scale for axes in charts]
        height = figure.bbox.height * scale  # an SVG counts downwards
        edges = [[left, right, height - above, height - below] for left, below, right, above in boxes]
        return drawn[drawn.index("<svg") :], [[round(float(x), 2) for x in box] for box in edges]

    def _figure(self, alpha: float = 1.0) -> tuple[Any, list[Axes]]:
        """The figure with all curves, and its charts."""
        figure = new_figure(*self._size)
        charts = chart_axes(figure, len(self.panels))
        for axes, panel in zip(charts, self.panels, strict=True):
            for curve, width in zip(panel.curves, _widths(panel), strict=True):
                axes.plot(curve.values, color=css(curve.color), label=curve.label, linewidth=width, alpha=alpha)
            axes.set_xlabel("step")
            axes.set_xlim(0, self.last)
            steps: Any = axes.xaxis.get_major_locator()
            steps.set_params(integer=True)
            if panel.from_zero:
                axes.set_ylim(bottom=0)
            heading(axes, panel.title, legend=len(panel.curves) > 1)
        return figure, charts


class Frames:
    """Pictures of a timeline with its cursor at a step; curves are faint beyond it. What stands still is drawn once."""

    def __init__(self, timeline: Timeline) -> None:
        self._figure, charts = timeline._figure(_FAINT)
        self._cursors = [_Cursor(axes, panel) for axes, panel in zip(charts, timeline.panels, strict=True)]
        canvas = self._figure.canvas
        canvas.draw()
        self._still = canvas.copy_from_bbox(self._figure.bbox)

    def at(self, step: int) -> Image.Image:
        """The picture of a step, 0 to T - 1."""
        self._figure.canvas.restore_region(self._still)
        for cursor in self._cursors:
            cursor.draw(step)
        return picture(self._figure, drawn=True)


class _Cursor:
    """What moves in one chart: a rule, and the curves up to it, each with a dot at its end."""

    def __init__(self, axes: Axes, panel: Panel) -> None:
        self._axes, self._panel = axes, panel
        self._rule = axes.axvline(0, color=css(MUTED), linewidth=1, animated=True)
        self._lines: list[Line2D] = [
            axes.plot([], color=css(curve.color), linewidth=width, animated=True)[0]
            for curve, width in zip(panel.curves, _widths(panel), strict=True)
        ]
        self._dots: list[Line2D] = [_dots(axes, [], [], c.color, animated=True) for c in panel.curves]
        color = css(panel.curves[0].color)
        self._value: Text = axes.text(
            1, 1.03, "", transform=axes.transAxes, ha="right", va="bottom", fontsize=10, color=color, animated=True
        )

    def draw(self, step: int) -> None:
        """Draw them at ``step``."""
        self._rule.set_xdata([step, step])
        for line, dot, curve in zip(self._lines, self._dots, self._panel.curves, strict=True):
            line.set_data(np.arange(step + 1), curve.values[: step + 1])
            dot.set_data([step], [curve.values[step]])
        if self._panel.unit:
            self._value.set_text(f"{self._panel.curves[0].values[step]:.1f} {self._panel.unit}")
        for artist in (self._rule, *self._lines, *self._dots, self._value):
            self._axes.draw_artist(artist)


def _widths(panel: Panel) -> list[float]:
    """Widths of a panel's curves: earlier ones are wider, so that equal ones all show."""
    return [1.6 + 1.8 * later for later in reversed(range(len(panel.curves)))]


def _dots(
    axes: Axes, steps: Sequence[int], values: Sequence[float] | np.ndarray, color: Color, animated: bool = False
) -> Line2D:
    """White-edged dots, whole at the chart's edges."""
    (dots,) = axes.plot(steps, values, "o", color=css(color), markersize=7, markeredgecolor="white", zorder=3)
    dots.set(clip_on=False, animated=animated, in_layout=False)
    return dots
