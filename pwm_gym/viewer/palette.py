"""Colours: teal is the world model, purple the simulator, green the goal."""

from __future__ import annotations

import colorsys

import numpy as np

from pwm_gym.scene import Layout

__all__ = ["BACKGROUND", "GOAL", "PREDICTED", "TRUE", "Color", "entity_colors", "tint"]

Color = tuple[int, int, int]

PREDICTED: Color = (0x0D, 0x52, 0x57)
"""Teal of predicted clouds (paper)."""
TRUE: Color = (0xD5, 0x33, 0xD6)
"""Purple of true clouds (paper)."""
GOAL: Color = (0x2E, 0xA0, 0x4F)
"""Green of goal markers."""
BACKGROUND: Color = (250, 251, 252)
"""Off-white of images."""

# Lightness added to the world's own, and factor on its saturation: links recede, objects stand out.
_EFFECTOR_TINTS = ((0.17, 0.60), (0.04, 0.80))
_OBJECT_TINTS = ((0.14, 1.30), (0.28, 1.10), (0.05, 1.00), (0.34, 0.90))


def tint(color: Color, lightness: float, saturation: float = 1.0) -> Color:
    """``color`` with ``lightness`` (of 1) added and its saturation scaled; the hue stays."""
    hue, light, sat = colorsys.rgb_to_hls(*(c / 255 for c in color))
    light, sat = min(max(light + lightness, 0.0), 0.9), min(sat * saturation, 1.0)
    red, green, blue = (round(255 * c) for c in colorsys.hls_to_rgb(hue, light, sat))
    return red, green, blue


def entity_colors(layout: Layout, color: Color = PREDICTED) -> np.ndarray:
    """Colours (N, 3) uint8 of a layout's points: every entity a tint of the world's ``color``.

    The first effector link (the hand) is pale, further links (the fingers) are deep, objects are vivid.
    """
    colors = np.empty((layout.points, 3), dtype=np.uint8)
    links = objects = 0
    for entity in layout:
        if entity.driven:
            shade = _EFFECTOR_TINTS[min(links, 1)]
            links += 1
        else:
            shade = _OBJECT_TINTS[objects % len(_OBJECT_TINTS)]
            objects += 1
        colors[entity.slice] = tint(color, *shade)
    return colors
