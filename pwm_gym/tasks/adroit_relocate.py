"""AdroitHandRelocate: bring the ball to a goal in the air (Gymnasium-Robotics ``AdroitHandRelocate-v1``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import Points, register_success, register_terms, terms
from pwm_gym.costs.adroit import PALM_PLACE, distance
from pwm_gym.robots.adroit import RELOCATE_ARM, RELOCATE_HAND, layout
from pwm_gym.sim.mujoco.adroit import NEAR, relocate_simulator
from pwm_gym.skills import HandReach
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["ADROIT_RELOCATE", "AdroitRelocateExplorer"]

_VERY_NEAR = 0.05  # metres
_LIFTED = 0.04  # metres: height of the ball's centre over the table
_LAYOUT = layout({"ball": 200}, {})
_ball = terms.middle("ball")
_reach = distance(PALM_PLACE, _ball)
_place, _hand_place = distance(_ball, terms.goal_position), distance(PALM_PLACE, terms.goal_position)


@register_success("adroit_relocate")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Bool (B,): the ball is within 10 cm of its goal."""
    return _place(points, info) < NEAR


def _lifted(points: Points, info: terms.Info) -> Tensor:
    """What the environment pays (B,) for a ball in the air: the nearer to the goal the more."""
    carried = 1.0 - 0.5 * _hand_place(points, info) - 0.5 * _place(points, info)
    return carried * (_ball(points, info)[..., 2] > _LIFTED)


def _bonus(points: Points, info: terms.Info) -> Tensor:
    """What it pays (B,) for a ball near the goal."""
    way = _place(points, info)
    return 10.0 * (way < NEAR) + 20.0 * (way < _VERY_NEAR)


register_terms(  # minus the environment's dense reward, whose first term pays for distance from the ball
    "adroit_relocate",
    {"distance": (-0.1, _reach), "lifted": (-1.0, _lifted), "bonus": (-1.0, _bonus)},
)


def _height(points: Points, info: terms.Info) -> Tensor:
    """Height (B,) of the ball over the table, up to 5 cm."""
    return (_ball(points, info)[..., 2] - 0.035).clamp(0.0, 0.05)


register_terms(
    "adroit_relocate_plan",
    {"reach": (2.0, _reach), "height": (-20.0, _height), "place": (3.0, _place)},
)


@dataclass(frozen=True)
class AdroitRelocateExplorer:
    """Reaches over the ball, bends the fingers around it and goes to the goal: exploration, which seldom lifts it."""

    reach: HandReach
    aside: np.ndarray
    """From the ball's centre (3,), metres."""
    wrist: np.ndarray
    bend: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> AdroitRelocateExplorer:
        """Explorer of a random way."""
        reach = HandReach(RELOCATE_ARM, rng.uniform(2.5, 5.0))
        return cls(reach, rng.normal(0.0, [0.02, 0.02, 0.01]), rng.uniform(-1.0, 1.0, 2), rng.uniform(0.4, 1.0))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (30,) for poses (26, 7) of the hand's links and the ball, and the ball's goal (3,)."""
        ball, place = poses[_LAYOUT.index("ball"), :3], self.reach.place(poses)
        near = np.linalg.norm(place - ball - self.aside) < 0.04
        if near and self.reach.bent(poses) > 0.5 * self.bend:
            return self.reach.act(poses, goal, self.bend, self.wrist)
        return self.reach.act(poses, ball + self.aside, self.bend if near else 0.1, self.wrist)


ADROIT_RELOCATE = register_task(
    Task(
        name="AdroitHandRelocate",
        description="Bring the ball to a goal in the air with a hand of 24 joints.",
        layout=_LAYOUT,
        goal_size=3,
        robot=RELOCATE_HAND,
        simulator=relocate_simulator,
        expert=AdroitRelocateExplorer.sample,
        expert_steps=100,
        cost="adroit_relocate",
        plan_cost="adroit_relocate_plan",
        success="adroit_relocate",
        max_episode_steps=200,
    )
)
