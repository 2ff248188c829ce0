"""What some world models, and the states that they move, can do besides :class:`~pwm_gym.dynamics.model.WorldModel`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from torch import Tensor

from pwm_gym.scene import Scene, State

if TYPE_CHECKING:
    from pwm_gym.dynamics.compact.uncertainty import ErrorHead

__all__ = [
    "FitsResponse",
    "LearnsError",
    "MeetsScenes",
    "MovesArms",
    "MovesFewerPoints",
    "ReadsPoints",
    "RollsOut",
    "TellsError",
    "Transitions",
    "expected_error",
]


@dataclass(frozen=True)
class Transitions:
    """Single steps of a robot, as a response is fitted to them."""

    links: Tensor
    """Poses (M, 3, L, 4, 4) of the model's links at t, t-1, t-2."""
    actions: Tensor
    """(M, A)."""
    following: Tensor
    """The links' next poses (M, L, 4, 4)."""
    joints: Tensor
    """The robot's joint positions and velocities (M, 2, J)."""
    following_joints: Tensor
    """The same after the step."""
    floor: float
    """Height of what the robot may run into below, metres."""


@runtime_checkable
class FitsResponse(Protocol):
    """A model with parts that are fitted on single steps before it is trained on rollouts."""

    def fit_response(self, transitions: Transitions, arm_steps: int) -> None:
        """Fit them; ``arm_steps`` optimiser steps go to the arms' joints."""


@runtime_checkable
class LearnsError(Protocol):
    """A model with a head that is fitted, when all else is trained, to tell its error."""

    error: ErrorHead | None

    def step_with_tokens(self, state: State, action: Tensor) -> tuple[State, Tensor]:
        """Next state (B,), and the entity tokens (B, E, C) that its motions were decoded from."""


@runtime_checkable
class MeetsScenes(Protocol):
    """A model that needs more of a scene than its state tells, such as the names of its assets."""

    def meet(self, scenes: Sequence[Scene]) -> None:
        """Take states as ones of these scenes, until it meets others."""


@runtime_checkable
class MovesArms(Protocol):
    """A model whose states carry the joints of the arms that it knows."""

    def own_joints(self, joints: Tensor) -> Tensor:
        """Those joints (..., 2, J) of the robot's (..., 2, J')."""


@runtime_checkable
class ReadsPoints(Protocol):
    """A model that reads some of each entity's points alone."""

    @property
    def read_points(self) -> int:
        """Points of each entity, its cloud's first; 0 is all."""


@runtime_checkable
class RollsOut(Protocol):
    """A model that predicts a horizon faster than step by step."""

    def rollout(self, state: State, actions: Tensor) -> State:
        """States (B, H) from ``state`` (B,) under ``actions`` (B, H, A)."""


@runtime_checkable
class MovesFewerPoints(Protocol):
    """A model that was trained to move some of each entity's points alone."""

    @property
    def moved_points(self) -> int:
        """Points of each entity, its cloud's first; 0 is all."""


@runtime_checkable
class TellsError(Protocol):
    """A state whose model tells how far it may be from the truth."""

    @property
    def error(self) -> Tensor | None:
        """Expected distance (..., E) of each entity's points from the truth, metres; None where it is not told."""


def expected_error(state: State) -> Tensor | None:
    """Expected distance (..., E) of each entity's points from the truth, metres, where the state's model tells it."""
    return state.error if isinstance(state, TellsError) else None
