"""What some world models, and the states that they move, can do besides :class:`~pwm_gym.dynamics.model.WorldModel`."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from torch import Tensor

from pwm_gym.scene import State

__all__ = ["MovesFewerPoints", "RollsOut", "TellsError", "expected_error"]


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
