"""What the simulator's environment shows of a scene: all of it, what one camera sees, or what is made of that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch

from pwm_gym.completion import Completer, HullCompleter, LearnedCompleter, load_completion
from pwm_gym.costs import cost_info, get_grasp
from pwm_gym.data.partial import CAMERA, PartialView
from pwm_gym.errors import SceneError, unknown_name
from pwm_gym.perception import Frame, IdSegmenter, SceneObserver
from pwm_gym.scene import Layout, Scene, batch_state
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sensing import DepthCamera, RayCaster
from pwm_gym.sensing.sensor import SensorModel, get_sensor
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

__all__ = ["OBSERVATIONS", "CompletedSight", "Sensing", "Sight", "build_sight"]

OBSERVATIONS = ("complete", "completed", "partial")
_SCALE = 2  # the camera's pixels for each of the partial view's: objects of a few centimetres need some dozen across


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


class _PartialSight:
    """Shows the points that a camera sees, repeated up to each entity's count."""

    def __init__(self, view: PartialView) -> None:
        self.info: dict[str, Any] = {}
        self._view = view

    def reset(self, seed: int) -> None:
        pass

    def __call__(self, truth: Scene) -> Scene:
        return self._view(truth)


class CompletedSight:
    """Shows what the perception pipeline makes of a camera's depth and of the joint angles.

    Args:
        task: of the scenes.
        layout: their points.
        simulator: its meshes are what the camera sees.
        clouds: canonical points (N, 3) of the layout; the robot's links keep theirs.
        sensing: how.
    """

    def __init__(self, task: Task, layout: Layout, simulator: Simulator, clouds: np.ndarray, sensing: Sensing) -> None:
        self.info: dict[str, Any] = {}
        self._task, self._caster = task, RayCaster(simulator.meshes(), layout)
        self._camera = sensing.camera or CAMERA.resize(_SCALE)
        self._sensor: SensorModel = get_sensor(sensing.sensor)
        completer = _completer(sensing.completer)
        self._observer = SceneObserver(task.name, layout, task.robot(), IdSegmenter(layout), completer, clouds=clouds)
        self._last: Scene | None = None
        self._rng = np.random.default_rng(0)

    def reset(self, seed: int) -> None:
        """Begin an episode; ``seed`` is of the sensor's noise."""
        self._observer.reset()
        self._last, self._rng = None, np.random.default_rng(seed)

    def __call__(self, truth: Scene) -> Scene:
        """The estimated scene; ``info`` tells each object's expected error and the stages' times."""
        if truth.joints is None:
            raise SceneError("scene.joints is None; a completed observation needs joint positions")
        poses = matrix_from_pose7(torch.as_tensor(truth.poses[0], dtype=torch.float64)).numpy()
        view = self._caster.view(self._camera, poses)
        depth = self._sensor.apply(view.depth, self._camera, self._rng)
        frame = Frame(None, depth, self._camera, view.segmentation.astype(np.int64), truth.joints[0])
        seen = self._observer(frame, truth.goal, truth.last_action, self._carried(truth.last_action))
        self._last = seen.scene
        self.info = {"completion_error": seen.errors, "perception_seconds": sum(seen.seconds.values())}
        return seen.scene

    def _carried(self, action: np.ndarray | None) -> dict[str, str]:
        """The moved object on the hand, if the last estimate says that it is grasped."""
        if self._last is None or action is None:
            return {}
        state, goal = batch_state([self._last]), torch.as_tensor(self._last.goal)[None]
        _, info = cost_info(state, torch.as_tensor(action)[None], goal, get_grasp(self._task.grasp))
        root = next(e.name for e in self._task.layout if e.effector and e.slider is None)
        return {self._task.object: root} if bool(info["grasped"][0]) else {}


def build_sight(
    observation: str, task: Task, layout: Layout, simulator: Simulator, clouds: np.ndarray, sensing: Sensing
) -> Sight:
    """The sight called ``observation``.

    Raises:
        UnknownNameError: listing the known ones.
    """
    if observation not in OBSERVATIONS:
        raise unknown_name("observation", observation, OBSERVATIONS)
    if observation == "complete":
        return _CompleteSight()
    if observation == "partial":
        most = max(e.points for e in layout)
        return _PartialSight(PartialView(simulator.meshes(), layout, sensing.camera or CAMERA, most))
    return CompletedSight(task, layout, simulator, clouds, sensing)


def _completer(completer: str | Completer) -> Completer:
    if not isinstance(completer, str):
        return completer
    return HullCompleter() if completer == "hull" else LearnedCompleter(load_completion(completer)[0])
