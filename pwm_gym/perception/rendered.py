"""Ray-cast frames of scenes whose truth is known, and an observer that sees them through such a camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import torch

from pwm_gym.cameras import DepthCamera, RayCaster
from pwm_gym.cameras.sensor import get_sensor
from pwm_gym.errors import SceneError
from pwm_gym.perception.frame import Frame
from pwm_gym.perception.observer import Observation, SceneObserver
from pwm_gym.scene import Layout, Scene
from pwm_gym.scene.se3 import matrix_from_pose7

if TYPE_CHECKING:
    import trimesh

__all__ = ["FrameRenderer", "RenderedObserver"]


class FrameRenderer:
    """What a depth camera and the robot itself tell of a scene.

    Args:
        meshes: the entities' surfaces, metres, each in its own frame.
        layout: of the scenes.
        camera: looks.
        sensor: registered model of its errors.
    """

    def __init__(
        self, meshes: Mapping[str, trimesh.Trimesh], layout: Layout, camera: DepthCamera, sensor: str = "ideal"
    ) -> None:
        self.layout, self.camera = layout, camera
        self._caster, self._sensor = RayCaster(meshes, layout), get_sensor(sensor)
        self._driven = [i for i, e in enumerate(layout) if e.driven]

    def __call__(self, truth: Scene, rng: np.random.Generator) -> Frame:
        """A frame without colour, with the entities' true ids as its segmentation.

        Args:
            truth: the scene, with joints.
            rng: draws the sensor's noise.

        Raises:
            SceneError: the scene has no joints.
        """
        if truth.joints is None:
            raise SceneError("scene.joints is None; an observation needs the robot's joint positions")
        poses = matrix_from_pose7(torch.as_tensor(truth.poses[0], dtype=torch.float64)).numpy()
        view = self._caster.view(self.camera, poses)
        depth = self._sensor.apply(view.depth, self.camera, rng)
        links = truth.poses[0][self._driven]
        return Frame(None, depth, self.camera, view.segmentation.astype(np.int64), truth.joints[0], links)


class RenderedObserver:
    """Looks at scenes whose truth is known, one episode at a time.

    Args:
        observer: estimates the scenes; its segmenter gets the true ids.
        renderer: of what it sees.
    """

    def __init__(self, observer: SceneObserver, renderer: FrameRenderer) -> None:
        self.observer, self.renderer = observer, renderer
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
        return self.observer(self.renderer(truth, self._rng), truth.goal, truth.last_action, carried)
