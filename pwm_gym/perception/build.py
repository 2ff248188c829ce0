"""What a task's scenes look like through a camera and the perception pipeline."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pwm_gym.cameras import DepthCamera
from pwm_gym.cameras.viewpoints import CAMERA, CAMERA_SCALE
from pwm_gym.completion import Completer, build_completer
from pwm_gym.perception import FrameRenderer, IdSegmenter, RenderedObserver, SceneObserver
from pwm_gym.scene import Layout
from pwm_gym.tasks.registry import Task

if TYPE_CHECKING:
    from collections.abc import Mapping

    import trimesh

__all__ = ["build_observer"]


def build_observer(
    task: Task,
    layout: Layout,
    meshes: Mapping[str, trimesh.Trimesh],
    clouds: np.ndarray,
    completer: str | Completer = "default",
    camera: DepthCamera | None = None,
    sensor: str = "ideal",
) -> RenderedObserver:
    """An observer of a task's true scenes, as if by a depth camera and the robot's encoders.

    Of a robot whose kinematics are not known, the links' poses are taken to be reported by its controller.

    Args:
        task: gives the robot.
        layout: of the scenes.
        meshes: the entities' surfaces, metres, each in its own frame.
        clouds: canonical points (N, 3) of the layout, metres; the robot's links keep theirs.
        completer: as of :func:`~pwm_gym.completion.build_completer`.
        camera: looks; None takes the default one with twice its pixels.
        sensor: registered model of its errors.
    """
    made = build_completer(completer)
    robot = None if task.robot.cloud is None else task.robot.cloud()
    observer = SceneObserver(task.name, layout, robot, IdSegmenter(layout), made, clouds=clouds)
    renderer = FrameRenderer(meshes, layout, camera or CAMERA.resize(CAMERA_SCALE), sensor)
    return RenderedObserver(observer, renderer)
