"""What an observation model is, and how a camera observation is configured; :mod:`pwm_gym.envs.build` builds one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pwm_gym.errors import PwmGymError, unknown_name
from pwm_gym.scene import Layout, Scene

if TYPE_CHECKING:
    import trimesh

    from pwm_gym.cameras import DepthCamera
    from pwm_gym.completion import Completer

__all__ = ["OBSERVATIONS", "Bodies", "CameraConfig", "ObservationModel"]

OBSERVATIONS = ("complete", "completed", "partial")
"""What an environment may show."""


@dataclass(frozen=True)
class CameraConfig:
    """How a camera observation is made. Of names and numbers alone it survives a spec's JSON."""

    viewpoint: str | Mapping[str, Any] | DepthCamera = "right"
    """A registered viewpoint, the arguments of :meth:`pwm_gym.cameras.DepthCamera.looking` (``eye``, ``target``, ...),
    or a camera."""
    sensor: str = "ideal"
    """Registered sensor model."""
    completer: str | Completer = "default"
    """A checkpoint's folder, "default" for the shipped one, "hull", or a completer."""

    @classmethod
    def of(cls, value: CameraConfig | Mapping[str, Any] | str | None) -> CameraConfig:
        """The configuration that ``value`` stands for: itself, its fields by name, a viewpoint, or the default.

        Raises:
            UnknownNameError: a field that there is not.
            PwmGymError: a value of another type.
        """
        if value is None or isinstance(value, str):
            return cls() if value is None else cls(viewpoint=value)
        if isinstance(value, CameraConfig):
            return value
        if not isinstance(value, Mapping):
            raise PwmGymError(f"camera is a {type(value).__name__}; expected a CameraConfig, its fields or a viewpoint")
        known = [f.name for f in fields(cls)]
        for name in value:
            if name not in known:
                raise unknown_name("camera setting", name, known)
        return cls(**value)


@dataclass(frozen=True, eq=False)
class Bodies:
    """What a camera can see in one episode."""

    layout: Layout
    """The task's entities, and further bodies after them."""
    assets: tuple[str, ...]
    """Name of each entity's asset (E,)."""
    clouds: np.ndarray
    """Canonical points (N, 3) of the task's entities, metres."""
    meshes: Callable[[], Mapping[str, trimesh.Trimesh]]
    """Makes each entity's surface in its own frame, metres."""


class ObservationModel(Protocol):
    """Shows an episode's scenes, one after the other."""

    info: dict[str, Any]
    """What it tells of the last scene that it showed."""

    def reset(self, seed: int, bodies: Bodies) -> None:
        """Begin an episode of these bodies; ``seed`` is of the sensor's noise."""

    def __call__(self, truth: Scene) -> Scene:
        """What is shown of the next scene."""
