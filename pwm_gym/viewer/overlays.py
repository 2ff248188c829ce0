"""Many episodes on one sheet: both worlds over each other at a few steps, a strip an episode."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from pwm_gym.errors import PwmGymError
from pwm_gym.viewer.labels import INK, MUTED, fit, text
from pwm_gym.viewer.twin import TwinRecord, Views

__all__ = ["draw_overlays"]

_GAP, _TOP, _LABEL, _BETWEEN = 4, 44, 24, 20  # pixels
_COLORS = 128


def draw_overlays(
    records: Sequence[TwinRecord], title: str, panel: int = 112, steps: int = 5, across: int = 2
) -> Image.Image:
    """Each episode's overlay of the predicted and the true world, from its first step to its last.

    Args:
        records: the episodes; the subtitle of each stands above its strip.
        title: over all.
        panel: side of each view, pixels.
        steps: views of each episode.
        across: episodes in one line.

    Raises:
        PwmGymError: no episodes.
    """
    if not records:
        raise PwmGymError("no episodes to draw; expected at least one")
    across = min(across, len(records))
    width, height = steps * (panel + _GAP) - _GAP, _LABEL + panel + _GAP
    size = (across * (width + _BETWEEN) + _BETWEEN, _TOP + -(-len(records) // across) * height + _GAP)
    sheet = Image.new("RGB", size, (255, 255, 255))
    text(sheet, (_BETWEEN, 22), fit(title, 17, size[0] - 2 * _BETWEEN), 17, INK)
    for k, record in enumerate(records):
        left, top = _BETWEEN + k % across * (width + _BETWEEN), _TOP + k // across * height
        text(sheet, (left, top + _LABEL / 2), fit(record.subtitle, 13, width), 13, MUTED)
        views = Views(record, panel)
        for i, t in enumerate(np.linspace(0, record.steps - 1, steps).round().astype(int).tolist()):
            corner = (left + i * (panel + _GAP), top + _LABEL)
            sheet.paste(views.draw(2, t), corner)
            if record.stages:
                text(sheet, (corner[0] + 4, corner[1] + panel - 8), fit(record.stages[t], 11, panel - 8), 11, MUTED)
    return sheet.quantize(_COLORS, dither=Image.Dither.NONE)
