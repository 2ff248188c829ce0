"""Observation models: the truth, the points that a camera sees, and what is completed from its depth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pwm_gym.cameras import DepthCamera
from pwm_gym.cameras.sensor import get_sensor
from pwm_gym.cameras.viewpoints import CAMERA_SCALE, VIEWPOINTS
from pwm_gym.completion import build_completer
from pwm_gym.costs import cost_info, get_grasp
from pwm_gym.data.partial import PartialView
from pwm_gym.envs.observation_models import Bodies, CameraConfig
from pwm_gym.errors import PwmGymError, look_up
from pwm_gym.perception import FrameRenderer, RenderedObserver
from pwm_gym.perception.build import build_observer
from pwm_gym.scene import Layout, Scene, State, batch_state
from pwm_gym.tasks import Task

__all__ = ["CompleteObservation", "CompletedObservation", "PartialObservation", "carried_objects", "depth_camera"]


def depth_camera(viewpoint: str | Mapping[str, Any] | DepthCamera, scale: int = 1) -> DepthCamera:
    """The camera that a configuration's viewpoint stands for.

    Args:
        viewpoint: a registered name, arguments of :meth:`~pwm_gym.cameras.DepthCamera.looking`, or a camera.
        scale: factor on a registered viewpoint's pixels.

    Raises:
        UnknownNameError: no viewpoint of this name.
        PwmGymError: arguments that do not fit.
    """
    if isinstance(viewpoint, str):
        camera: DepthCamera = look_up("viewpoint", viewpoint, VIEWPOINTS)
        return camera.resize(scale)
    if isinstance(viewpoint, DepthCamera):
        return viewpoint
    try:
        return DepthCamera.looking(**viewpoint)
    except TypeError as error:
        raise PwmGymError(f"viewpoint {dict(viewpoint)}: {error}") from error


class CompleteObservation:
    """Shows the truth."""

    def __init__(self) -> None:
        self.info: dict[str, Any] = {}

    def reset(self, seed: int, bodies: Bodies) -> None:
        """Nothing is drawn at random."""

    def __call__(self, truth: Scene) -> Scene:
        """The scene itself."""
        return truth


class PartialObservation:
    """Shows the points that a camera sees, repeated up to each entity's count.

    Args:
        camera: tells the viewpoint.
    """

    def __init__(self, camera: CameraConfig) -> None:
        self.info: dict[str, Any] = {}
        self._camera = depth_camera(camera.viewpoint)
        self._seen: tuple[Layout, tuple[str, ...]] | None = None
        self._view: PartialView | None = None

    def reset(self, seed: int, bodies: Bodies) -> None:
        """Begin an episode; nothing is drawn at random."""
        if (bodies.layout, bodies.assets) != self._seen:
            most = max(e.points for e in bodies.layout)
            self._view = PartialView(bodies.meshes(), bodies.layout, self._camera, most)
            self._seen = bodies.layout, bodies.assets

    def __call__(self, truth: Scene) -> Scene:
        """The scene with the points that are seen."""
        assert self._view is not None, "call reset() first"
        return self._view(truth)


class CompletedObservation:
    """Shows what the perception pipeline makes of a camera's depth and of the joint angles.

    Args:
        task: task of the scenes.
        camera: viewpoint, sensor and completer.

    Raises:
        UnknownNameError: an unknown viewpoint, sensor or checkpoint of completion.
    """

    def __init__(self, task: Task, camera: CameraConfig) -> None:
        self.info: dict[str, Any] = {}
        self._task, self._sensor = task, camera.sensor
        get_sensor(camera.sensor)  # an unknown name is refused now
        self._camera = depth_camera(camera.viewpoint, CAMERA_SCALE)
        self._completer = build_completer(camera.completer)
        self._layout: Layout | None = None
        self._assets: tuple[str, ...] | None = None
        self._observer: RenderedObserver | None = None
        self._last: Scene | None = None

    def reset(self, seed: int, bodies: Bodies) -> None:
        """Begin an episode; ``seed`` is of the sensor's noise."""
        layout = bodies.layout
        if self._observer is None or layout != self._layout:
            self._observer = build_observer(
                self._task, layout, bodies.meshes(), bodies.clouds, self._completer, self._camera, self._sensor
            )
        elif bodies.assets != self._assets:
            self._observer.renderer = FrameRenderer(bodies.meshes(), layout, self._camera, self._sensor)
        self._layout, self._assets, self._last = layout, bodies.assets, None
        self._observer.reset(seed)

    def __call__(self, truth: Scene) -> Scene:
        """The estimated scene; ``info`` tells each object's expected error and the pipeline's time."""
        assert self._observer is not None, "call reset() first"
        seen = self._observer(truth, self._carried(truth.last_action))
        self._last = replace(seen.scene, assets=truth.assets)
        self.info = {"completion_error": seen.errors, "perception_seconds": sum(seen.seconds.values())}
        return self._last

    def _carried(self, action: np.ndarray | None) -> dict[str, str]:
        """Object -> hand, of what the last estimate says is grasped."""
        if self._last is None or action is None:
            return {}
        state, goal = batch_state([self._last]), torch.as_tensor(self._last.goal)[None]
        return carried_objects(self._task, state, torch.as_tensor(action)[None], goal)


def carried_objects(task: Task, state: State, action: Tensor, goal: Tensor) -> dict[str, str]:
    """Object -> the hand that carries it, in a state (1,) that an action (1, A) led to, for a goal (1, G).

    A task's grasp rule asks about one object; each object that can be carried is put in its place in turn.
    """
    rule, layout = get_grasp(task.grasp), state.layout
    hands, loose = [layout.names[i] for i in layout.hands], [layout.names[i] for i in layout.loose]
    points, info = cost_info(state, action, goal, rule)
    asked = _Renamed(points, {})
    rule(asked, {**info, "velocity": _Renamed(info["velocity"], {})})
    target = next((name for name in asked.read if name in loose), None)
    if target is None or not hands:
        return {}
    carried = {}
    for name in loose:
        swap = {target: name, name: target}
        if bool(rule(_Renamed(points, swap), {**info, "velocity": _Renamed(info["velocity"], swap)})[0]):
            middle = points[name].mean(-2)
            distances = [float((points[hand].mean(-2) - middle).norm()) for hand in hands]
            carried[name] = hands[int(np.argmin(distances))]
    return carried


class _Renamed(Mapping[str, Tensor]):
    """Points under other names, and which names were asked for."""

    def __init__(self, points: Mapping[str, Tensor], names: Mapping[str, str]) -> None:
        self._points, self._names = points, names
        self.read: list[str] = []

    def __getitem__(self, name: str) -> Tensor:
        self.read.append(name)
        return self._points[self._names.get(name, name)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._points)

    def __len__(self) -> int:
        return len(self._points)
