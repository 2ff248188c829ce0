"""FetchPush: push the block over the table to its goal (Gymnasium-Robotics ``FetchPush-v4``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwm_gym.costs import register_grasp, register_success, register_terms, shaped, terms
from pwm_gym.costs.pushes import pushing_terms
from pwm_gym.robots.fetch import FETCH, layout
from pwm_gym.robots.gripper import FETCH as GRIPPER
from pwm_gym.sim import Simulator
from pwm_gym.skills import TablePush
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["FETCH_PUSH", "FetchPushExpert"]

_GOAL_RADIUS = 0.05  # metres: the simulator's threshold for the block's distance from the goal
_CONTACT = 0.04  # metres from the tool to the block's centre where shut fingers push it
_AT_GOAL = 0.02  # metres from the goal where the expert leaves the block alone
_LAYOUT = layout({"object": 300})

register_grasp("fetch_push")(terms.pinch("object", GRIPPER))
_success = register_success("fetch_push")(terms.near("object", terms.goal_position, _GOAL_RADIUS))

_reach = terms.reach("object", GRIPPER)
_place = terms.nearness(terms.centre("object"), terms.goal_position)
register_terms(  # minus the dense reward: the tool near the block, the block near its goal; -1 at success
    "fetch_push",
    shaped.normalised(4.0, {"pushing": (None, 0.0, lambda p, i: _reach(p, i) + 3.0 * _place(p, i))}, _success),
)
register_terms("fetch_push_plan", pushing_terms("object", GRIPPER, _CONTACT))


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
    from pwm_gym.sim.mujoco.fetch import fetch_simulator

    return fetch_simulator("FetchPush-v4", lambda now: (now.reach + 3.0 * now.place) / 4.0, objects=["object"])


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
