"""Observation models by name."""

from __future__ import annotations

from pwm_gym.envs.observation_models import OBSERVATIONS, CameraConfig, ObservationModel
from pwm_gym.errors import unknown_name
from pwm_gym.tasks import Task

__all__ = ["build_observation_model"]


def build_observation_model(observation: str, task: Task, camera: CameraConfig) -> ObservationModel:
    """The observation model called ``observation``, one of :data:`~pwm_gym.envs.observation_models.OBSERVATIONS`.

    Args:
        observation: name.
        task: task of the scenes.
        camera: configuration of a camera's observation.

    Raises:
        UnknownNameError: no such observation, viewpoint, sensor or checkpoint of completion.
    """
    if observation not in OBSERVATIONS:
        raise unknown_name("observation", observation, OBSERVATIONS)
    # Cameras and perception are loaded where they are used.
    from pwm_gym.envs import camera_models

    if observation == "complete":
        return camera_models.CompleteObservation()
    if observation == "partial":
        return camera_models.PartialObservation(camera)
    return camera_models.CompletedObservation(task, camera)
