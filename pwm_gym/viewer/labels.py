"""Text and swatches of the figures, drawn with Pillow."""

from __future__ import annotations

from functools import lru_cache

from PIL import Image, ImageDraw, ImageFont

from pwm_gym.viewer.palette import Color

__all__ = ["INK", "MUTED", "fit", "swatch", "text"]

INK: Color = (28, 38, 46)
"""Colour of headings and values."""
MUTED: Color = (98, 110, 120)
"""Colour of what stands beside them."""

_SMOOTH = 4  # swatches are drawn so many times larger and shrunk, since Pillow's edges are not smooth


@lru_cache(maxsize=16)
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)


def text(
    image: Image.Image, at: tuple[float, float], string: str, size: int = 14, color: Color = INK, anchor: str = "lm"
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
