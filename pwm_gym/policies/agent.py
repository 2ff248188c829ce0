"""A policy where a planner is expected: in seeded episodes, records and tables."""

from __future__ import annotations

from typing import Any, Protocol

from torch import Tensor

from pwm_gym.dynamics.baselines import Still
from pwm_gym.errors import PwmGymError
from pwm_gym.planning import Agent
from pwm_gym.scene import RigidState
from pwm_gym.tasks import get_task

__all__ = ["ActsOnPoses", "PolicyAgent"]


class ActsOnPoses(Protocol):
    """A policy of rigid scenes."""

    def act(self, state: RigidState, goal: Tensor) -> Tensor:
        """Actions (B, A) in states (B,) for goals (B, G)."""


class PolicyAgent(Agent):
    """Acts as a policy says. It predicts nothing: between two looks it takes the scene to stand still.

    Args:
        policy: of a task's scenes.
        task: registered task.
    """

    def __init__(self, policy: ActsOnPoses, task: str) -> None:
        known = get_task(task)
        super().__init__(Still(known.layout, known.control), task)
        self.policy = policy

    def _actions(self, steps: int | None = None) -> Tensor:
        """Actions (B, 1, A) from the present state.

        Raises:
            PwmGymError: there is no state yet, or one that has no entity poses.
        """
        state = self._present()
        if not isinstance(state, RigidState):
            raise PwmGymError(f"a policy acts on entity poses; the state is a {type(state).__name__}")
        return self.policy.act(state, self._goal).unsqueeze(1)

    def describe(self) -> dict[str, Any]:
        """What acts: the policy in the planner's place; the cost is what records tell it by."""
        return {**super().describe(), "planner": type(self.policy).__name__}
