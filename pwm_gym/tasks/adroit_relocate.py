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

__all__ = ["ADROIT_RELOCATE", "AdroitRelocateExpert"]

_VERY_NEAR = 0.05  # metres
_LIFTED = 0.04  # metres: height of the ball's centre over the table
_OVER = 0.03  # metres beside the ball within which the hand comes down
_NEAR, _SHUTS, _HOLDS = 0.035, 0.05, 0.06  # metres from the grasp: fingers shut, go on to shut, hold the ball
_SHUT, _BENT = 0.46, 0.4  # shares of the fingers' bend: of a grasp, and of one under way
_OPEN = 0.11  # bend of the fingers on their way there
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
class AdroitRelocateExpert:
    """Comes down over the ball, bends the fingers around it, and carries it to the goal in small steps.

    Its numbers were found by the cross-entropy method in the simulator.
    """

    reach: HandReach
    aside: np.ndarray
    """Place before the palm when the ball is grasped, from the ball's centre (3,), metres."""
    wrist: np.ndarray
    """Targets (2,) in [-1, 1]."""
    bend: float
    """Of the fingers around the ball, 0 straight to 1."""
    thumb: tuple[float, float]
    """Targets of its first two joints there in [-1, 1]."""
    above: float
    """Height over the ball, metres, while the hand is beside it."""
    step: float
    """How far ahead the carried ball's goal is at most, metres."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> AdroitRelocateExpert:
        """Expert of a slightly random way."""
        return cls(
            HandReach(RELOCATE_ARM, rng.normal(4.0, 0.05)),
            rng.normal([0.0, -0.03, -0.01], 0.002),
            rng.normal([0.44, -0.52], 0.02),
            rng.normal(0.83, 0.01),
            (rng.normal(0.46, 0.02), rng.normal(0.89, 0.02)),
            rng.normal(0.05, 0.005),
            rng.normal(0.2, 0.005),
        )

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (30,) for poses (26, 7) of the hand's links and the ball, and the ball's goal (3,)."""
        grasp, place = poses[_LAYOUT.index("ball"), :3] + self.aside, self.reach.place(poses)
        off = place - grasp
        away, bent = float(np.linalg.norm(off)), self.reach.bent(poses) / self.bend
        if bent > _SHUT and away < _HOLDS:
            way = goal - place
            target = place + way * min(1.0, self.step / max(float(np.linalg.norm(way)), 1e-6))
            return self.reach.act(poses, target, self.bend, self.wrist, thumb=self.thumb)
        if away < _NEAR or (away < _SHUTS and bent > _BENT):
            return self.reach.act(poses, grasp, self.bend, self.wrist, thumb=self.thumb)
        beside = np.linalg.norm(off[:2]) > _OVER
        lifted = np.array([0.0, 0.0, self.above if beside else 0.0])
        return self.reach.act(poses, grasp + lifted, _OPEN, self.wrist, thumb=(self.thumb[0], -1.0))


ADROIT_RELOCATE = register_task(
    Task(
        name="AdroitHandRelocate",
        description="Bring the ball to a goal in the air with a hand of 24 joints.",
        layout=_LAYOUT,
        goal_size=3,
        robot=RELOCATE_HAND,
        simulator=relocate_simulator,
        expert=AdroitRelocateExpert.sample,
        expert_steps=120,
        cost="adroit_relocate",
        plan_cost="adroit_relocate_plan",
        success="adroit_relocate",
        max_episode_steps=200,
    )
)
