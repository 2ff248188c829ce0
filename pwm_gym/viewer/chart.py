"""Text, swatches and line charts of the figures, drawn with Pillow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pwm_gym.viewer.palette import PREDICTED, TRUE, Color, tint

__all__ = [
    "AXIS",
    "INK",
    "MUTED",
    "Chart",
    "Curve",
    "dot",
    "draw_growth",
    "draw_quartiles",
    "fit",
    "nice_ticks",
    "swatch",
    "text",
]

INK: Color = (28, 38, 46)
MUTED: Color = (98, 110, 120)
AXIS: Color = (222, 227, 231)

_SMOOTH = 4  # curves are drawn so many times larger and shrunk, since Pillow's lines are not smooth
_FAINT = 0.28  # strength of what the cursor has not reached
_TICK_SIZE, _TITLE_SIZE = 12, 14


@lru_cache(maxsize=16)
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)


def text(
    image: Image.Image,
    at: tuple[float, float],
    string: str,
    size: int = _TITLE_SIZE,
    color: Color = INK,
    anchor: str = "lm",
) -> float:
    """Write ``string`` (Pillow's anchors) and return its width in pixels."""
    draw = ImageDraw.Draw(image)
    draw.text(at, string, fill=color, font=_font(size), anchor=anchor)
    return draw.textlength(string, font=_font(size))


def fit(string: str, size: int, width: float) -> str:
    """``string``, shortened with dots to at most ``width`` pixels."""
    font = _font(size)
    if font.getlength(string) <= width:
        return string
    while string and font.getlength(string + "...") > width:
        string = string[:-1]
    return string.rstrip() + "..."


def swatch(image: Image.Image, at: tuple[float, float], color: Color, size: int = 12) -> None:
    """A small rounded square of ``color``, centred vertically at ``at`` and starting there."""
    side = size * _SMOOTH
    mask = Image.new("L", (side, side), 0)
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, side - 1, side - 1), side // 4, fill=255)
    image.paste(color, (round(at[0]), round(at[1] - size / 2)), mask.resize((size, size), Image.Resampling.BOX))


def dot(image: Image.Image, at: tuple[float, float], color: Color, radius: int = 5) -> None:
    """A disc of ``color`` with a white outline, centred at ``at``."""
    size = 2 * radius + 2
    side = size * _SMOOTH
    for inset, fill in ((0, (255, 255, 255)), (2 * _SMOOTH, color)):
        mask = Image.new("L", (side, side), 0)
        ImageDraw.Draw(mask).ellipse((inset, inset, side - 1 - inset, side - 1 - inset), fill=255)
        place = (round(at[0] - size / 2), round(at[1] - size / 2))
        image.paste(fill, place, mask.resize((size, size), Image.Resampling.BOX))


def nice_ticks(low: float, high: float, count: int = 4) -> np.ndarray:
    """About ``count`` round values that enclose ``low`` to ``high``."""
    span = max(high - low, 1e-9)
    raw = span / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((f for f in (1, 2, 2.5, 5, 10) if f * power >= raw * (1 - 1e-9)), default=10)
    first, last = np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9)
    return np.arange(first, max(last, first + 1) + 1) * step


@dataclass(frozen=True, eq=False)
class Curve:
    """Values (T,) over steps 0 to T - 1."""

    label: str
    values: np.ndarray
    color: Color


class Chart:
    """A line chart over time in a box of an image (left, top, right, bottom, in pixels)."""

    def __init__(
        self,
        box: tuple[int, int, int, int],
        title: str,
        curves: Sequence[Curve],
        from_zero: bool = False,
        unit: str = "",
        across: str = "step",
        pitch: float = 1.0,
    ) -> None:
        self.title, self.curves, self.unit, self.across = title, tuple(curves), unit, across
        self.pitch = pitch  # what one step stands for on the axis
        left, top, right, bottom = box
        self.top, self.edge = top, right
        values = np.concatenate([c.values for c in curves])
        low, high = (0.0, 1e-6) if not len(values) else (float(values.min()), float(values.max()))
        self.ticks = nice_ticks(0.0 if from_zero else low, max(high, low + 1e-6))
        self.steps = max(max(len(c.values) for c in curves) - 1, 1)
        self.plot = (left + 44, top + 32, right - 6, bottom - 40)

    def x(self, step: float) -> float:
        """Pixel column of a step."""
        left, _, right, _ = self.plot
        return left + (right - left) * step / self.steps

    def y(self, value: float) -> float:
        """Pixel row of a value."""
        _, top, _, bottom = self.plot
        return bottom - (bottom - top) * (value - self.ticks[0]) / (self.ticks[-1] - self.ticks[0])

    def draw(self, image: Image.Image) -> Image.Image:
        """Draw axes and faint curves on ``image``; returns the same picture with curves in full strength."""
        self._axes(image)
        full = image.copy()
        for curve in self.curves:
            mask = self._stroke(curve, image.size)
            image.paste(curve.color, (0, 0), mask.point(lambda v: round(v * _FAINT)))
            full.paste(curve.color, (0, 0), mask)
        return full

    def reveal(self, image: Image.Image, full: Image.Image, step: int) -> None:
        """Draw the cursor at ``step`` on ``image``, with the curves of ``full`` to its left."""
        _, top, _, bottom = self.plot
        column = round(self.x(step))
        area = (self.plot[0] - 4, top - 4, column, bottom + 4)
        image.paste(full.crop(area), area[:2])
        ImageDraw.Draw(image).line((column, top, column, bottom), fill=MUTED)
        self.mark(image, step)
        if self.unit:
            now = f"{self.curves[0].values[step]:.1f} {self.unit}"
            text(image, (self.edge, self.top + 10), now, _TITLE_SIZE, self.curves[0].color, "rm")

    def mark(self, image: Image.Image, step: int) -> None:
        """A dot on every curve at ``step``."""
        for curve in self.curves:
            if step < len(curve.values):
                dot(image, (self.x(step), self.y(float(curve.values[step]))), curve.color)

    def _axes(self, image: Image.Image) -> None:
        left, _, right, bottom = self.plot
        draw = ImageDraw.Draw(image)
        pitch = self.ticks[1] - self.ticks[0]
        digits = max(0, int(np.ceil(-np.log10(pitch) - 1e-9)) + (0 if f"{pitch:e}"[2] == "0" else 1))
        for tick in self.ticks:
            row = round(self.y(tick))
            draw.line((left, row, right, row), fill=AXIS)
            text(image, (left - 8, row), f"{tick:.{digits}f}", _TICK_SIZE, MUTED, "rm")
        for tick in _whole_ticks(self.steps):
            column = round(self.x(tick))
            draw.line((column, bottom, column, bottom + 4), fill=MUTED)
            text(image, (column, bottom + 14), f"{tick * self.pitch:g}", _TICK_SIZE, MUTED, "mm")
        draw.line((left, bottom, right, bottom), fill=MUTED)
        text(image, ((left + right) / 2, bottom + 31), self.across, _TICK_SIZE, MUTED, "mm")
        self._heading(image)

    def _heading(self, image: Image.Image) -> None:
        """Title at the left, the curves' names at the right."""
        row, column = self.top + 10, float(self.edge)
        text(image, (self.plot[0] - 44, row), self.title)
        for curve in self.curves[::-1]:
            if not curve.label:
                continue
            column -= text(image, (column, row), curve.label, 13, MUTED, "rm") + 18
            swatch(image, (column, row), curve.color)
            column -= 18

    def _stroke(self, curve: Curve, size: tuple[int, int]) -> Image.Image:
        """Coverage of a curve, smooth."""
        left, top, right, bottom = (v + pad for v, pad in zip(self.plot, (-4, -4, 4, 4), strict=True))
        large = Image.new("L", ((right - left) * _SMOOTH, (bottom - top) * _SMOOTH), 0)
        points = [
            ((self.x(i) - left) * _SMOOTH, (self.y(float(v)) - top) * _SMOOTH) for i, v in enumerate(curve.values)
        ]
        if len(points) > 1:
            ImageDraw.Draw(large).line(points, fill=255, width=round(2.2 * _SMOOTH), joint="curve")
        mask = Image.new("L", size, 0)
        mask.paste(large.resize((right - left, bottom - top), Image.Resampling.BOX), (left, top))
        return mask


def _whole_ticks(steps: int) -> list[int]:
    """Round step numbers from 0 to at most ``steps``."""
    ticks = nice_ticks(0, steps, 5)
    pitch = max(1, round(float(ticks[1] - ticks[0])))
    return list(range(0, steps + 1, pitch))


def draw_quartiles(panels: Mapping[str, np.ndarray], title: str, size: tuple[int, int] = (460, 300)) -> Image.Image:
    """A picture of charts side by side, each of quartiles (3, T) of one quantity over steps 1 to T.

    Args:
        panels: title of a chart -> lower quartile, median and upper quartile.
        title: over all of them.
        size: of one chart, pixels.
    """
    width, height = size
    image = Image.new("RGB", (20 + len(panels) * (width + 20), height + 60), (255, 255, 255))
    text(image, (20, 24), title, 17)
    for k, (name, (low, middle, high)) in enumerate(panels.items()):
        left = 20 + k * (width + 20)
        curves = (
            Curve("quartiles", high, tint(PREDICTED, 0.4)),
            Curve("", low, tint(PREDICTED, 0.4)),
            Curve("median", middle, PREDICTED),
        )
        image = Chart((left, 48, left + width, 48 + height), name, curves, from_zero=True).draw(image)
    return image


def draw_growth(
    panels: Mapping[str, Mapping[str, Mapping[float, float]]], title: str, size: tuple[int, int] = (400, 300)
) -> Image.Image:
    """A picture of charts side by side, each of how quantities grow with a size, straight lines, carried on to zero.

    Args:
        panels: name of a size -> label of a curve (two in all at most) -> size (a whole number) -> seconds.
        title: over all of them.
        size: of one chart, pixels.
    """
    width, height = size
    labels = list(dict.fromkeys(label for curves in panels.values() for label in curves))
    colors = dict(zip(labels, (PREDICTED, TRUE)[: len(labels)], strict=True))
    image = Image.new("RGB", (20 + len(panels) * (width + 20), height + 60), (255, 255, 255))
    text(image, (20, 24), title, 17)
    for place, (name, curves) in enumerate(panels.items()):
        left = 20 + place * (width + 20)
        pitch = float(np.gcd.reduce([round(x) for curve in curves.values() for x in curve]))
        lines = []
        for label, known in curves.items():
            sizes = np.arange(0.0, max(known) + 0.5 * pitch, pitch)
            x = np.array(sorted(known))
            y = np.array([known[k] for k in x])
            start = y[0] - x[0] * (y[1] - y[0]) / (x[1] - x[0]) if len(x) > 1 else 0.0
            values = np.interp(sizes, [0.0, *x], [max(start, 0.0), *y])
            lines.append(Curve(label, values, colors[label]))
        box = (left, 48, left + width, 48 + height)
        image = Chart(box, "seconds", lines, from_zero=True, across=name, pitch=pitch).draw(image)
    return image


def draw_calibration(
    bins: Sequence[Mapping[str, float]], title: str, size: tuple[int, int] = (620, 340)
) -> Image.Image:
    """Expected and real errors in bins of the expected one, from the surest predictions to the least sure.

    Args:
        bins: each with "expected", "real_mean" and "real_median", metres.
        title: over the chart.
        size: of the chart, pixels.
    """
    width, height = size
    image = Image.new("RGB", (width + 40, height + 60), (255, 255, 255))
    text(image, (20, 24), title, 17)
    names = {
        "expected": ("expected", PREDICTED),
        "real_mean": ("real, mean", TRUE),
        "real_median": ("real, median", MUTED),
    }
    curves = []
    for key, (label, color) in names.items():
        millimetres = 1e3 * np.array([b[key] for b in bins])
        curves.append(Curve(label, np.log10(millimetres.clip(1e-6)), color))
    across = "bins of the expected error, surest first"
    return Chart((20, 48, 20 + width, 48 + height), "error (mm, powers of ten)", curves, across=across).draw(image)
