"""PickYCB: lift one of many objects from the table to a goal position (ManiSkill ``PickSingleYCB-v1``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from torch import Tensor

from pwm_gym.costs import Points, objects, register_grasp, register_success, register_terms, shaped, terms
from pwm_gym.costs.motion import joint_speed
from pwm_gym.errors import PwmGymError
from pwm_gym.robots.panda import JOINT_SPEEDS, PANDA, layout
from pwm_gym.sim import Simulator
from pwm_gym.skills import ObjectGrasps, PickObject
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["PICK_YCB", "PickYcbExpert"]

_GOAL_RADIUS, _STATIC = 0.025, 0.2  # metres and rad/s: ManiSkill's thresholds of success
_SETS = ("seen", "unseen", "liftable", "unseen_liftable", "all")
_LAYOUT = layout({"object": 300})

_at_goal = objects.near("object", terms.goal_position, _GOAL_RADIUS)
register_grasp("pick_ycb")(terms.near_and_shut("object"))
register_grasp("pick_ycb_contact")(objects.held("object"))  # of long objects, which are held far from their centre


@register_success("pick_ycb")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Object within 2.5 cm of the goal and the arm static."""
    return _at_goal(points, info) & (joint_speed(points, info, JOINT_SPEEDS) <= _STATIC)


_placed = objects.placed("object", _at_goal)
_REWARDS = {
    "reaching": objects.reach("object"),
    "contact": objects.grasped("object"),
    "placing": objects.place("object", terms.goal_position),
    "placed": _placed,
    "static": objects.still(JOINT_SPEEDS, _placed),
}
_BONUS = shaped.success_bonus(_success, whole=6.0, parts=[*_REWARDS.values()])

register_terms(  # minus ManiSkill's normalised shaped reward; -1 at success
    "pick_ycb", {name: (-1 / 6, term) for name, term in {**_REWARDS, "success": _BONUS}.items()}
)
register_terms(
    "pick_ycb_plan",  # reach from above with open fingers across a narrow side, pinch, carry, settle
    {
        "approach": (1.5, objects.approach("object")),
        "premature_close": (4.0, objects.premature_close("object")),
        "finger_blocking": (3.0, objects.finger_blocking("object")),
        "misalignment": (2.0, objects.misalignment("object")),
        "ground_contact": (1.0, terms.ground_contact),
        "effort": (1.0, terms.effort),
        "disturbance": (0.5, objects.disturbance("object")),
        "carry": (-2.0, objects.carry("object", terms.goal_position)),
        "settle": (0.3, objects.settle("object", terms.goal_position, JOINT_SPEEDS, _STATIC)),
    },
)


@dataclass(frozen=True)
class PickYcbExpert:
    """Grasp the episode's object as is known to hold it, then carry it to the goal."""

    grasps: Callable[[str], ObjectGrasps]  # of an object, by its name
    speed: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> PickYcbExpert:
        """Expert of a random speed."""
        from pwm_gym.assets import available_assets, object_grasps

        return cls(cache(partial(object_grasps, available_assets())), rng.uniform(0.022, 0.032))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (7,) for poses (4, 7) of hand, fingers and object, and the goal (3,) of the object's origin."""
        if not assets:
            raise PwmGymError("the expert of PickYCB was given no assets; it chooses grasps by the object's name")
        return PickObject(self.grasps(assets[_LAYOUT.index("object")]), self.speed).act(poses, goal)


def _simulator(objects: str | Sequence[str] = _SETS[0]) -> Simulator:
    from pwm_gym.assets import ObjectChoice, available_assets, select_objects, use_assets
    from pwm_gym.sim.maniskill import ManiSkillSimulator

    use_assets(folder := available_assets())
    choice = ObjectChoice(folder, select_objects(folder, objects))
    return ManiSkillSimulator(
        "PickSingleYCB-v1",
        {**PANDA.links, "object": choice.actor},
        goal="goal_site",
        control=PANDA.control,
        robot_uids="panda",
        assets=choice,
    )


PICK_YCB = register_task(
    Task(
        name="PickYCB",
        description="Lift one of many objects from the table to a goal position.",
        robot=PANDA,
        layout=_LAYOUT,
        goal_size=3,
        simulator=_simulator,
        object_sets=_SETS,
        expert_steps=50,
        expert=PickYcbExpert.sample,
        cost="pick_ycb",
        plan_cost="pick_ycb_plan",
        success="pick_ycb",
        grasp="pick_ycb",
        max_episode_steps=150,
    )
)
