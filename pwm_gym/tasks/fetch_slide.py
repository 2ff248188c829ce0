"""FetchSlide: tap the puck so that it slides over the table to its goal (Gymnasium-Robotics ``FetchSlide-v4``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwm_gym.costs import register_grasp, register_success, register_terms, terms
from pwm_gym.costs.pushes import Slide, pushed_terms, pushing_terms
from pwm_gym.robots.fetch import FETCH, WIDE_TABLE, layout
from pwm_gym.robots.gripper import FETCH as GRIPPER
from pwm_gym.sim import Simulator
from pwm_gym.sim.mujoco.fetch import GOAL_RADIUS, fetch_simulator
from pwm_gym.skills import TableTap
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["FETCH_SLIDE", "FetchSlideExpert"]

_CONTACT = 0.04  # metres from the tool to the puck's centre where shut fingers touch it
_SLIDE = Slide(slow=1.13e-3, fast=1.49e-3, fast_from=0.0125)  # metres a step; measured on free slides of demonstrations
_RADIUS = 0.025  # metres: the puck's
_HALF = (0.0135, 0.0149)  # metres: half the sides of the shut fingers
_STROKES = (0.0, 8.0, 15.0, 22.0, 30.0, 37.0, 45.0, 52.0, 60.0, 67.0, 75.0, 82.0, 90.0)  # degrees; measured
_LAUNCHES = (0.0, 6.5, 10.5, 16.4, 33.2, 41.6, 45.5, 47.5, 55.0, 67.5, 80.3, 84.8, 90.0)  # degrees that come of them
_SLIDES = (0.5, 0.495, 0.475, 0.46, 0.55, 0.63, 0.72, 0.71, 0.65, 0.57, 0.52, 0.53, 0.53)  # metres, at full strength
_REACH = 0.83  # metres from the base; measured, too
_AT_GOAL = 0.04  # metres from the goal where the expert leaves the puck alone
_LAYOUT = layout({"object": 300}, WIDE_TABLE)

register_grasp("fetch_slide")(terms.pinch("object", GRIPPER))
_success = register_success("fetch_slide")(terms.near("object", terms.goal_position, GOAL_RADIUS))

register_terms("fetch_slide", pushed_terms("object", GRIPPER, _success))  # minus the dense reward
register_terms("fetch_slide_plan", pushing_terms("object", GRIPPER, _CONTACT, _SLIDE))


@dataclass(frozen=True)
class FetchSlideExpert:
    """Tap the puck with shut fingers from behind."""

    tap: TableTap

    @classmethod
    def sample(cls, rng: np.random.Generator) -> FetchSlideExpert:
        """Expert of a random height."""
        height = rng.uniform(0.029, 0.031)
        return cls(
            TableTap(FETCH, _LAYOUT.index("object"), _RADIUS, _HALF, 0.05, _STROKES, _LAUNCHES, _SLIDES, _REACH, height)
        )

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (4,) for poses (4, 7) of hand, fingers and puck, and the puck's goal (3,)."""
        if np.linalg.norm(goal[:2] - poses[self.tap.entity, :2]) < _AT_GOAL:
            return np.array([0.0, 0.0, 0.0, -1.0], np.float32)
        return self.tap.act(poses, goal)


def _simulator() -> Simulator:
    return fetch_simulator("FetchSlide-v4", lambda now: now.pushed, objects=["object"])


FETCH_SLIDE = register_task(
    Task(
        name="FetchSlide",
        description="Tap the puck so that it slides over the table to its goal.",
        layout=_LAYOUT,
        goal_size=3,
        robot=FETCH,
        simulator=_simulator,
        expert=FetchSlideExpert.sample,
        expert_steps=30,
        cost="fetch_slide",
        plan_cost="fetch_slide_plan",
        success="fetch_slide",
        grasp="fetch_slide",
        max_episode_steps=50,
    )
)
