"""Entities, canonical clouds, rigid motions and the batched state. Knows nothing of simulators or learning."""

from pwm_gym.scene.cloud import resample_clouds, sample_clouds, sample_surface, spacing, spread
from pwm_gym.scene.features import POSE_FEATURES, pose_features
from pwm_gym.scene.joint import FIXED, FREE, Joint, Mimic
from pwm_gym.scene.layout import Entity, Layout, Support
from pwm_gym.scene.positions import joint_positions, within_limits
from pwm_gym.scene.scene import SCHEMA, Scene, batch_state
from pwm_gym.scene.state import EntityPoints, PointState, RigidState, State, stack

__all__ = [
    "FIXED",
    "FREE",
    "POSE_FEATURES",
    "SCHEMA",
    "Entity",
    "EntityPoints",
    "Joint",
    "Layout",
    "Mimic",
    "PointState",
    "RigidState",
    "Scene",
    "State",
    "Support",
    "batch_state",
    "joint_positions",
    "pose_features",
    "resample_clouds",
    "sample_clouds",
    "sample_surface",
    "spacing",
    "spread",
    "stack",
    "within_limits",
]
