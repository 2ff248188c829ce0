"""FetchReach: bring the tool to a goal position in the air (Gymnasium-Robotics ``FetchReach-v4``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pwm_gym.costs import Points, register_grasp, register_success, register_terms, shaped, terms
from pwm_gym.robots.fetch import FETCH, layout
from pwm_gym.robots.gripper import FETCH as GRIPPER
from pwm_gym.sim import Simulator
from pwm_gym.sim.mujoco.fetch import GOAL_RADIUS, fetch_simulator
from pwm_gym.skills import drive
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["FETCH_REACH", "FetchReachExpert"]

_LAYOUT = layout({})
_tool = terms.tool_of(GRIPPER)
_place = terms.nearness(_tool, terms.goal_position)


def _distance(points: Points, info: terms.Info) -> Tensor:
    """Distance (B,) from the tool to the goal, metres."""
    return (_tool(points, info) - terms.goal_position(points, info)).norm(dim=-1)


@register_grasp("fetch_reach")
def _nothing_held(points: Points, info: terms.Info) -> Tensor:
    """Nothing: there is no object."""
    return torch.zeros_like(_distance(points, info), dtype=torch.bool)


@register_success("fetch_reach")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Tool within 5 cm of the goal."""
    return _distance(points, info) < GOAL_RADIUS


register_terms(  # minus the dense reward: nearness of the tool to the goal; -1 at success
    "fetch_reach",
    shaped.normalised(1.0, {"placing": (None, 0.0, _place)}, _success),
)
register_terms(
    "fetch_reach_plan",
    {
        "distance": (5.0, _distance),
        "near": (1.0, lambda points, info: torch.tanh(_distance(points, info) / 0.02)),
    },
)


@dataclass(frozen=True)
class FetchReachExpert:
    """Straight to the goal."""

    speed: float
    """Longest translation asked for in a step, metres."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> FetchReachExpert:
        """Expert of a random speed."""
        return cls(rng.uniform(0.02, 0.05))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (4,) for poses (3, 7) of hand and fingers, and the tool's goal (3,)."""
        assert FETCH.tool is not None
        return drive(FETCH, goal - FETCH.tool(poses)[:3], self.speed, gripper=-1.0)


def _simulator() -> Simulator:
    return fetch_simulator("FetchReach-v4", lambda now: now.place)


FETCH_REACH = register_task(
    Task(
        name="FetchReach",
        description="Bring the tool to a goal position in the air.",
        layout=_LAYOUT,
        goal_size=3,
        robot=FETCH,
        simulator=_simulator,
        expert=FetchReachExpert.sample,
        expert_steps=10,
        cost="fetch_reach",
        plan_cost="fetch_reach_plan",
        success="fetch_reach",
        grasp="fetch_reach",
        max_episode_steps=50,
    )
)
