"""FetchPickAndPlace: bring the block to a goal on the table or in the air (``FetchPickAndPlace-v4``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwm_gym.costs import register_grasp, register_success, register_terms, shaped, terms
from pwm_gym.robots.fetch import FETCH, layout
from pwm_gym.robots.gripper import FETCH as GRIPPER
from pwm_gym.sim import Simulator
from pwm_gym.sim.mujoco.fetch import GOAL_RADIUS, Instant, fetch_simulator
from pwm_gym.skills import TopGrasp, drive
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["FETCH_PICK_AND_PLACE", "FetchPickAndPlaceExpert"]

_WIDTH = 0.05  # metres
_LAYOUT = layout({"object": 300})

_held = terms.pinch("object", GRIPPER)
register_grasp("fetch_pick_and_place")(_held)
_success = register_success("fetch_pick_and_place")(terms.near("object", terms.goal_position, GOAL_RADIUS))

_reach = terms.reach("object", GRIPPER)
_place = terms.nearness(terms.centre("object"), terms.goal_position)
register_terms(  # minus the dense reward: reach, hold, bring to the goal; -1 at success
    "fetch_pick_and_place",
    shaped.normalised(4.0, {"bringing": (None, 0.0, shaped.bring(_reach, _held, _place))}, _success),
)
register_terms(
    "fetch_pick_and_place_plan",  # reach from above with open fingers, pinch, carry
    {
        "approach": (1.5, terms.approach("object", gripper=GRIPPER)),
        "premature_close": (4.0, terms.premature_close("object", GRIPPER)),
        "finger_blocking": (3.0, terms.finger_blocking("object", GRIPPER)),
        "ground_contact": (1.0, terms.ground_contact),
        "disturbance": (0.5, terms.disturbance("object", gripper=GRIPPER)),
        "carry": (-2.0, terms.carry("object", terms.goal_position, GRIPPER, most=6.0, farthest=0.6)),
    },
)


@dataclass(frozen=True)
class FetchPickAndPlaceExpert:
    """Grasp from above, then carry to the goal."""

    grasp: TopGrasp

    @classmethod
    def sample(cls, rng: np.random.Generator) -> FetchPickAndPlaceExpert:
        """Expert of a random speed and hover height."""
        speed, hover = rng.uniform(0.03, 0.05), rng.uniform(0.06, 0.09)
        return cls(TopGrasp(FETCH, _LAYOUT.index("object"), _WIDTH, speed, hover))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (4,) for poses (4, 7) of hand, fingers and block, and the block's goal (3,)."""
        if self.grasp.holds(poses):
            return drive(FETCH, goal - poses[self.grasp.entity, :3], self.grasp.speed, gripper=-1.0)
        return self.grasp.act(poses)


def _simulator() -> Simulator:
    def reward(now: Instant) -> float:
        return (now.reach + now.held * (1.0 + now.place)) / 4.0

    return fetch_simulator("FetchPickAndPlace-v4", reward, objects=["object"])


FETCH_PICK_AND_PLACE = register_task(
    Task(
        name="FetchPickAndPlace",
        description="Bring the block to a goal on the table or in the air.",
        layout=_LAYOUT,
        goal_size=3,
        robot=FETCH,
        simulator=_simulator,
        expert=FetchPickAndPlaceExpert.sample,
        expert_steps=25,
        cost="fetch_pick_and_place",
        plan_cost="fetch_pick_and_place_plan",
        success="fetch_pick_and_place",
        grasp="fetch_pick_and_place",
        max_episode_steps=50,
    )
)
