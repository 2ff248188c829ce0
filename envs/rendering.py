"""Pictures of one world, for ``render_mode="rgb_array"``, and the window of ``"human"``."""

from __future__ import annotations

import importlib.util
import os
import sys
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError, check_whole
from pwm_gym.scene import Layout
from pwm_gym.viewer import PREDICTED, TRUE, Camera, entity_colors, render, tabletop_camera

__all__ = ["SceneRenderer", "Window", "modes_here", "picture_camera"]

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
_UNSEEN = ("dummy", "offscreen")  # drivers that SDL falls back to where it finds no display


def picture_camera(width: int, height: int) -> Camera:
    """The camera of an environment's pictures.

    Raises:
        PwmGymError: no whole number of pixels.
    """
    return tabletop_camera(check_whole("width", width, 1), check_whole("height", height, 1))


class SceneRenderer:
    """Draws a cloud (N, 3) and its goal: predicted worlds in teal, true ones in purple."""

    def __init__(self, layout: Layout, world: str, camera: Camera) -> None:
        self.layout = layout
        self._camera = camera
        self._colors = entity_colors(layout, PREDICTED if world == "predicted" else TRUE)

    def __call__(self, points: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Picture (H, W, 3) uint8."""
        shown = np.nan_to_num(points)
        return render(shown, self._colors, self._camera, goal=goal if len(goal) == 3 else None)


def _obstacle() -> str | None:
    """Why no window can be opened here, or None."""
    if importlib.util.find_spec("pygame") is None:
        return "pygame: pip install 'pwm-gym[video]'"
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in _DISPLAYS):
        return "a display, and neither DISPLAY nor WAYLAND_DISPLAY is set"
    return None


def modes_here(modes: list[str]) -> list[str]:
    """Those of an environment's render modes that this machine can show: "human" needs pygame and a display."""
    return modes if _obstacle() is None else [mode for mode in modes if mode != "human"]


class Window:
    """A window on the screen, opened with its first picture.

    Args:
        fps: pictures a second at most.

    Raises:
        PwmGymError: pygame or a display is missing.
    """

    def __init__(self, fps: int) -> None:
        if (missing := _obstacle()) is not None:
            raise PwmGymError(f'render_mode="human" needs {missing}; "rgb_array" needs neither window nor pygame')
        self._fps = fps
        self._screen: Any = None
        self._clock: Any = None

    def show(self, picture: np.ndarray) -> None:
        """Show a picture (H, W, 3) uint8 for a frame's time."""
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        import pygame

        if self._screen is None:
            self._open(picture.shape[1], picture.shape[0])
        self._screen.blit(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._fps)

    def _open(self, width: int, height: int) -> None:
        import pygame

        try:
            pygame.display.init()
            driver = pygame.display.get_driver()
            if driver in _UNSEEN and os.environ.get("SDL_VIDEODRIVER") != driver:
                raise pygame.error(f"SDL found no display and fell back to {driver!r}")
            self._screen = pygame.display.set_mode((width, height))
        except pygame.error as error:
            pygame.display.quit()
            raise PwmGymError(f'render_mode="human" cannot open a window: {error}; "rgb_array" needs none') from error
        pygame.display.set_caption("pwm_gym")
        self._clock = pygame.time.Clock()

    def close(self) -> None:
        """Close the window; calling it twice is harmless."""
        if self._screen is not None:
            import pygame

            pygame.display.quit()
            self._screen = None
