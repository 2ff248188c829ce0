"""A simulator as a source of poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from pwm_gym.scene import Scene

if TYPE_CHECKING:
    import trimesh

__all__ = ["Past", "PlacesBodies", "SimOutcome", "Simulator", "StartsUnderway"]


@dataclass(frozen=True)
class SimOutcome:
    """What the simulator says of the step just made."""

    reward: float
    """The simulator's own shaped reward."""
    success: bool
    grasped: bool
    holding: tuple[str, ...] = ()
    """Arms that stayed where they were, because what the action asked for is out of their reach."""


@runtime_checkable
class Simulator(Protocol):
    """Ground truth of one task. Poses, goals and points are in the robot base's frame."""

    action_size: int

    def meshes(self) -> Mapping[str, trimesh.Trimesh]:
        """Each entity's surface in its own frame, metres."""

    def reset(self, seed: int) -> None:
        """Start the episode of ``seed``."""

    def restore(self, scene: Scene, rebuild: bool = True) -> None:
        """Start from ``scene``: its poses, velocities, joints and goal.

        What else is free in the scene after the task's own entities is built, too, where the simulator can do so.

        Args:
            scene: to start from.
            rebuild: whether the future may depend on ``scene`` alone, in the last digit, too; it takes longer.
        """

    def step(self, action: np.ndarray) -> SimOutcome:
        """Apply an action (A,) in [-1, 1] for one control step."""

    def outcome(self) -> SimOutcome:
        """Reward, success and grasp of the present instant."""

    def assets(self) -> tuple[str, ...]:
        """Name of each entity's asset in this episode (E,): its own name, where it is always the same."""

    def poses(self) -> np.ndarray:
        """Entity poses (E, 7), float64: xyz in metres, unit quaternion wxyz."""

    def goal(self) -> np.ndarray:
        """Goal (G,), float32."""

    def joints(self) -> np.ndarray:
        """Joint positions and velocities (2, J) float32: radians (sliding joints: metres), and these a control step."""

    def close(self) -> None:
        """Free the simulator; calling it twice is harmless."""


@runtime_checkable
class PlacesBodies(Protocol):
    """A simulator that can put free bodies anywhere: what scenes that no episode starts from are made with."""

    def place(self, name: str, pose: np.ndarray) -> None:
        """Put the free body ``name`` at rest at a pose (7,) in the base's frame."""


@dataclass(frozen=True)
class Past:
    """What led to the start of an episode that begins in motion."""

    poses: np.ndarray
    """Entity poses (3, E, 7) at the start and one and two control steps before it."""
    action: np.ndarray
    """Action (A,) in [-1, 1] of the last of these steps."""


@runtime_checkable
class StartsUnderway(Protocol):
    """A simulator some of whose episodes begin in motion; those of all others begin at rest."""

    def past(self) -> Past | None:
        """What led to the start of the present episode; None where it starts at rest."""
