"""What the simulator's environment shows of a scene: all of it, what one camera sees, or what is made of that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pwm_gym.scene import Layout, Scene
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

if TYPE_CHECKING:
    from pwm_gym.cameras import DepthCamera
    from pwm_gym.completion import Completer

__all__ = ["OBSERVATIONS", "Sensing", "Sight", "build_sight"]

OBSERVATIONS = ("complete", "completed", "partial")
"""What an environment may show."""


@dataclass(frozen=True, eq=False)
class Sensing:
    """How a camera observation is made."""

    camera: DepthCamera | None = None
    """Where it looks from; None takes the default, in front of the robot to its right."""
    sensor: str = "ideal"
    """Registered sensor model."""
    completer: str | Completer = "default"
    """A checkpoint's folder, "default" for the shipped one, "hull", or a completer."""


class Sight(Protocol):
    """Shows an episode's scenes, one after the other."""

    info: dict[str, Any]
    """What it tells of the last scene that it showed."""

    def reset(self, seed: int) -> None:
        """Begin an episode; ``seed`` is of the sensor's noise."""

    def __call__(self, truth: Scene) -> Scene:
        """What is shown of the next scene."""


class _CompleteSight:
    """Shows the truth."""

    def __init__(self) -> None:
        self.info: dict[str, Any] = {}

    def reset(self, seed: int) -> None:
        pass

    def __call__(self, truth: Scene) -> Scene:
        return truth


def build_sight(
    observation: str, task: Task, layout: Layout, simulator: Simulator, clouds: np.ndarray, sensing: Sensing
) -> Sight:
    """The sight called ``observation``, one of :data:`OBSERVATIONS`."""
    if observation == "complete":
        return _CompleteSight()
    from pwm_gym.envs.camera_models import CompletedSight, PartialSight  # perception is loaded where it is used

    if observation == "partial":
        return PartialSight(layout, simulator, sensing)
    return CompletedSight(task, layout, simulator, clouds, sensing)
