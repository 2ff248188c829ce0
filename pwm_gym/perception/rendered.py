"""An observer behind a ray-cast camera: true scenes in, what perception makes of a view of them out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import torch

from pwm_gym.errors import SceneError
from pwm_gym.perception.frame import Frame
from pwm_gym.perception.observer import Observation, SceneObserver
from pwm_gym.scene import Scene
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sensing import DepthCamera, RayCaster
from pwm_gym.sensing.sensor import get_sensor

if TYPE_CHECKING:
    import trimesh

__all__ = ["RenderedObserver"]


class RenderedObserver:
    """Looks at scenes whose truth is known, one episode at a time.

    Args:
        observer: estimates the scenes; its segmenter gets the true ids.
        meshes: the entities' surfaces, which the camera sees.
        camera: looks.
        sensor: registered model of its errors.
    """

    def __init__(
        self,
        observer: SceneObserver,
        meshes: Mapping[str, trimesh.Trimesh],
        camera: DepthCamera,
        sensor: str = "ideal",
    ) -> None:
        self.observer, self.camera = observer, camera
        self._caster, self._sensor = RayCaster(meshes, observer.layout), get_sensor(sensor)
        self._rng = np.random.default_rng(0)

    def reset(self, seed: int) -> None:
        """Begin an episode; ``seed`` is of the sensor's noise."""
        self.observer.reset()
        self._rng = np.random.default_rng(seed)

    def __call__(self, truth: Scene, carried: Mapping[str, str] | None = None) -> Observation:
        """What is made of a view of the next scene.

        Args:
            truth: the scene, with joints.
            carried: object -> link, of what is grasped.

        Raises:
            SceneError: the scene has no joints, or an object is not seen in the first view.
        """
        if truth.joints is None:
            raise SceneError("scene.joints is None; an observation needs the robot's joint positions")
        poses = matrix_from_pose7(torch.as_tensor(truth.poses[0], dtype=torch.float64)).numpy()
        view = self._caster.view(self.camera, poses)
        depth = self._sensor.apply(view.depth, self.camera, self._rng)
        frame = Frame(None, depth, self.camera, view.segmentation.astype(np.int64), truth.joints[0])
        return self.observer(frame, truth.goal, truth.last_action, carried)
