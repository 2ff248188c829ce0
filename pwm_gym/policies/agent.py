"""A policy where a planner is expected: in seeded episodes, records and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from pwm_gym.dynamics.baselines import Still
from pwm_gym.errors import PwmGymError
from pwm_gym.planning import Agent
from pwm_gym.scene import RigidState, Scene
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

    def plan(self, scene: Scene | Sequence[Scene] | None = None) -> np.ndarray:
        """Actions (1, A), or (B, 1, A) of several scenes.

        Raises:
            PwmGymError: there is no state yet, or one that has no entity poses.
        """
        if scene is not None:
            self.look(scene)
        state = self._present()
        if not isinstance(state, RigidState):
            raise PwmGymError(f"a policy acts on entity poses; the state is a {type(state).__name__}")
        actions = self.policy.act(state, self._goal).cpu().numpy()[:, None]
        return np.asarray(actions[0] if self._one else actions)

    def describe(self) -> dict[str, Any]:
        """What acts: the policy in the planner's place; the cost is what records tell it by."""
        return {**super().describe(), "planner": type(self.policy).__name__}
