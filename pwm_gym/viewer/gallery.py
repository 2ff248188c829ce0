"""Clouds side by side, a row an object: what was seen, what was made of it, and what is true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from pwm_gym.errors import PwmGymError
from pwm_gym.viewer.camera import Camera
from pwm_gym.viewer.labels import INK, MUTED, fit, text
from pwm_gym.viewer.palette import BACKGROUND, PREDICTED, TRUE, Color
from pwm_gym.viewer.splat import render

__all__ = ["GalleryRow", "draw_gallery"]

_SEEN: Color = (120, 132, 142)
_COLORS = (_SEEN, PREDICTED, TRUE)
_GAP, _TOP, _LABEL = 8, 44, 22


@dataclass(frozen=True, eq=False)
class GalleryRow:
    """One object: three clouds in one frame, whose lengths are in units of its size."""

    label: str
    clouds: tuple[np.ndarray, np.ndarray, np.ndarray]
    """Points (n, 3) that are seen, completed and true."""


def draw_gallery(rows: Sequence[GalleryRow], title: str, panel: int = 150, across: int = 2) -> Image.Image:
    """A picture of objects, each as it is seen, completed and true, from a little beside the camera that saw it.

    Args:
        rows: objects, seen by a camera at the origin that looks along z.
        title: over all.
        panel: side of each view, pixels.
        across: objects in one line.

    Raises:
        PwmGymError: no objects.
    """
    if not rows:
        raise PwmGymError("no objects to draw; expected at least one")
    block = 3 * (panel + _GAP) + _GAP
    lines = -(-len(rows) // across)
    image = Image.new("RGB", (across * block + _GAP, _TOP + lines * (panel + _LABEL + _GAP)), (255, 255, 255))
    text(image, (_GAP, 20), title, 17, INK)
    for k, row in enumerate(rows):
        left, top = _GAP + k % across * block, _TOP + k // across * (panel + _LABEL + _GAP)
        text(image, (left, top + _LABEL / 2), fit(row.label, 13, block - 2 * _GAP), 13, MUTED)
        camera = _beside(row.clouds[2], panel)
        for i, (cloud, color) in enumerate(zip(row.clouds, _COLORS, strict=True)):
            drawn = render(cloud, np.array(color, np.uint8), camera, 0.012, BACKGROUND, ground=None)
            image.paste(Image.fromarray(drawn), (left + i * (panel + _GAP), top + _LABEL))
    return image


def _beside(cloud: np.ndarray, size: int) -> Camera:
    """A camera that sees the whole cloud from 50 degrees to the right of the origin, so that the far side shows."""
    middle = 0.5 * (cloud.min(0) + cloud.max(0))
    radius = float(np.linalg.norm(cloud - middle, axis=1).max())
    angle = np.deg2rad(50.0)
    direction = np.array([np.sin(angle), -0.45, -np.cos(angle)])
    eye = middle + 3.4 * radius * direction / np.linalg.norm(direction)
    return Camera(tuple(eye), tuple(middle), (0.0, -1.0, 0.0), 38.0, size, size)
