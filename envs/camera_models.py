"""What a camera's observations show of the simulator's scenes: partial clouds, and completed ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from pwm_gym.cameras.viewpoints import CAMERA
from pwm_gym.costs import cost_info, get_grasp
from pwm_gym.data.partial import PartialView
from pwm_gym.envs.observation_models import Sensing
from pwm_gym.perception.build import build_observer
from pwm_gym.scene import Layout, Scene, batch_state
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

__all__ = ["CompletedSight", "PartialSight"]


class PartialSight:
    """Shows the points that a camera sees, repeated up to each entity's count.

    Args:
        layout: of the scenes.
        simulator: its meshes hide points.
        sensing: the camera.
    """

    def __init__(self, layout: Layout, simulator: Simulator, sensing: Sensing) -> None:
        self.info: dict[str, Any] = {}
        most = max(e.points for e in layout)
        self._view = PartialView(simulator.meshes(), layout, sensing.camera or CAMERA, most)

    def reset(self, seed: int) -> None:
        """Nothing is drawn at random."""

    def __call__(self, truth: Scene) -> Scene:
        """The scene with the points that are seen."""
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
        self._task, meshes = task, simulator.meshes()
        self._look = build_observer(task, layout, meshes, clouds, sensing.completer, sensing.camera, sensing.sensor)
        self._last: Scene | None = None

    def reset(self, seed: int) -> None:
        """Begin an episode; ``seed`` is of the sensor's noise."""
        self._look.reset(seed)
        self._last = None

    def __call__(self, truth: Scene) -> Scene:
        """The estimated scene; ``info`` tells each object's expected error and the pipeline's time."""
        seen = self._look(truth, self._carried(truth.last_action))
        self._last = seen.scene
        self.info = {"completion_error": seen.errors, "perception_seconds": sum(seen.seconds.values())}
        return seen.scene

    def _carried(self, action: np.ndarray | None) -> dict[str, str]:
        """The moved object on the hand, if the last estimate says that it is grasped."""
        if self._last is None or action is None:
            return {}
        state, goal = batch_state([self._last]), torch.as_tensor(self._last.goal)[None]
        _, info = cost_info(state, torch.as_tensor(action)[None], goal, get_grasp(self._task.grasp))
        layout = self._task.layout
        return {self._task.objects[0]: layout.names[layout.hands[0]]} if bool(info["grasped"][0]) else {}
