"""What every world model offers."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from torch import Tensor

from pwm_gym.dynamics.protocols import RollsOut
from pwm_gym.scene import Layout, State, stack

__all__ = ["WorldModel", "rollout"]


@runtime_checkable
class WorldModel(Protocol):
    """Action-conditioned dynamics of a completed point cloud (paper, section 3, "3D Point World Model")."""

    links: Layout
    """The entities of its robot."""
    action_size: int

    def prepare(self, state: State) -> State:
        """The state in the form that this model moves: entity poses, or points."""

    def step(self, state: State, action: Tensor) -> State:
        """State (B,) one control step after action (B, A) in [-1, 1]."""


def rollout(model: WorldModel, state: State, actions: Tensor, prepared: bool = False) -> State:
    """States (B, H) that ``model`` predicts from ``state`` (B,) under ``actions`` (B, H, A).

    ``rollout(...).points()`` is (B, H, N, 3); step h is the state after action h. A model that rolls out faster than
    step by step has a ``rollout(state, actions)`` of its own. A state that is ``prepared`` is taken as it is.
    """
    if isinstance(model, RollsOut):
        return model.rollout(state, actions)
    state = state if prepared else model.prepare(state)
    states: list[State] = []
    for action in actions.unbind(1):
        state = model.step(state, action)
        states.append(state)
    return stack(states, 1)
