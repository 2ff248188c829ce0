"""Entities, canonical clouds, rigid motions and the batched state. Knows nothing of simulators or learning."""

from pwm_gym.scene.cloud import resample_clouds, sample_clouds, sample_surface, spacing, spread
from pwm_gym.scene.features import POSE_FEATURES, pose_features
from pwm_gym.scene.layout import Entity, Layout, Slider
from pwm_gym.scene.scene import Scene, batch_state
from pwm_gym.scene.state import EntityPoints, PointState, RigidState, State, stack

__all__ = [
    "POSE_FEATURES",
    "Entity",
    "EntityPoints",
    "Layout",
    "PointState",
    "RigidState",
    "Scene",
    "Slider",
    "State",
    "batch_state",
    "pose_features",
    "resample_clouds",
    "sample_clouds",
    "sample_surface",
    "spacing",
    "spread",
    "stack",
]
