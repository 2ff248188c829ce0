"""FetchPush: push the block over the table to its goal (Gymnasium-Robotics ``FetchPush-v4``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwm_gym.costs import register_grasp, register_success, register_terms, terms
from pwm_gym.costs.pushes import pushed_terms, pushing_terms
from pwm_gym.robots.fetch import FETCH, layout
from pwm_gym.robots.gripper import FETCH as GRIPPER
from pwm_gym.sim import Simulator
from pwm_gym.sim.mujoco.fetch import GOAL_RADIUS, fetch_simulator
from pwm_gym.skills import TablePush
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["FETCH_PUSH", "FetchPushExpert"]

_CONTACT = 0.04  # metres from the tool to the block's centre where shut fingers push it
_CLEAR = 0.08  # metres over the block's centre, below which shut fingers press it into the table and drag or tip it
_AT_GOAL = 0.02  # metres from the goal where the expert leaves the block alone
_LAYOUT = layout({"object": 300})

register_grasp("fetch_push")(terms.pinch("object", GRIPPER))
_success = register_success("fetch_push")(terms.near("object", terms.goal_position, GOAL_RADIUS))

register_terms("fetch_push", pushed_terms("object", GRIPPER, _success))  # minus the dense reward
register_terms("fetch_push_plan", pushing_terms("object", GRIPPER, _CONTACT, clear=_CLEAR))


@dataclass(frozen=True)
class FetchPushExpert:
    """Push from behind with shut fingers."""

    push: TablePush

    @classmethod
    def sample(cls, rng: np.random.Generator) -> FetchPushExpert:
        """Expert of a random speed and height."""
        speed, height = rng.uniform(0.025, 0.045), rng.uniform(0.022, 0.032)
        return cls(TablePush(FETCH, _LAYOUT.index("object"), _CONTACT, height, clearance=0.085, speed=speed))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (4,) for poses (4, 7) of hand, fingers and block, and the block's goal (3,)."""
        if np.linalg.norm(goal[:2] - poses[self.push.entity, :2]) < _AT_GOAL:
            return np.array([0.0, 0.0, 0.0, -1.0], np.float32)
        return self.push.act(poses, goal)


def _simulator() -> Simulator:
    return fetch_simulator("FetchPush-v4", lambda now: now.pushed, objects=["object"])


FETCH_PUSH = register_task(
    Task(
        name="FetchPush",
        description="Push the block over the table to its goal.",
        layout=_LAYOUT,
        goal_size=3,
        robot=FETCH,
        simulator=_simulator,
        expert=FetchPushExpert.sample,
        expert_steps=25,
        cost="fetch_push",
        plan_cost="fetch_push_plan",
        success="fetch_push",
        grasp="fetch_push",
        max_episode_steps=50,
    )
)
