"""A robot as tasks use it: its driven entities, its control, and how scripts drive it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pwm_gym.robots.control import Control
from pwm_gym.scene.joint import Joint

if TYPE_CHECKING:
    from pwm_gym.robots.cloud import RobotCloud

__all__ = ["Robot"]


@dataclass(frozen=True)
class Robot:
    """One embodiment; a checkpoint of a world model belongs to it."""

    name: str
    links: Mapping[str, str]
    """Driven entity -> name of the link in the simulator and the URDF; hands come before what hangs on them."""
    control: Control
    joints: Mapping[str, Joint] = field(default_factory=dict)
    """Driven entity -> joint on its parent, for all but the hands."""
    cloud: Callable[[], RobotCloud] | None = None
    """Makes the links' clouds from joint angles, in the order of the simulator's joints; perception needs it."""
    tool: Callable[[np.ndarray], np.ndarray] | None = None
    """Poses (E, 7) of a scene -> tool centre pose (7,); scripted behaviours need it."""
    opening: Callable[[np.ndarray], float] | None = None
    """Poses (E, 7) of a scene -> distance in metres between the gripper's pads; scripted grasps need it."""
    action: Callable[[np.ndarray, np.ndarray, float], np.ndarray] | None = None
    """Translation (3,) in metres, rotation vector (3,) in radians, gripper in [-1, 1] -> action (A,)."""
    action_names: tuple[str, ...] = ()
    """What each component of an action is called in pictures and documentation."""

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of the entities that it moves."""
        return tuple(self.links)
