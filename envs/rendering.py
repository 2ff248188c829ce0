"""Pictures of one world, for ``render_mode="rgb_array"``."""

from __future__ import annotations

import numpy as np

from pwm_gym.scene import Layout
from pwm_gym.viewer import PREDICTED, TRUE, entity_colors, render, tabletop_camera

__all__ = ["SceneRenderer"]


class SceneRenderer:
    """Draws a cloud (N, 3) and its goal: predicted worlds in teal, true ones in purple."""

    def __init__(self, layout: Layout, world: str) -> None:
        self.layout = layout
        self._camera = tabletop_camera()
        self._colors = entity_colors(layout, PREDICTED if world == "predicted" else TRUE)

    def __call__(self, points: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Picture (H, W, 3) uint8."""
        shown = np.nan_to_num(points)
        return render(shown, self._colors, self._camera, goal=goal if len(goal) == 3 else None)
