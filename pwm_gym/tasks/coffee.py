"""Coffee: put the pod into the machine's holder and shut the lid (a ManiSkill task of our own)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import (
    Points,
    lids,
    objects,
    register_grasp,
    register_stages,
    register_success,
    register_terms,
    sequences,
    shaped,
    terms,
)
from pwm_gym.costs.motion import joint_speed
from pwm_gym.robots.panda import JOINT_SPEEDS, PANDA, layout
from pwm_gym.scene import FIXED
from pwm_gym.sim import Simulator
from pwm_gym.sim.coffee_machine import LID_JOINT, SEATED, SHUT_ANGLE
from pwm_gym.skills import Brew
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["COFFEE", "CoffeeExpert"]

_STATIC = 0.2  # rad/s: the simulator's threshold
_JOINTS = {"machine": FIXED, "lid": LID_JOINT}
_LAYOUT = layout({"machine": 1408, "lid": 640, "pod": 512}, points=512, joints=_JOINTS)
_LID = lids.COFFEE_LID
_held = terms.pinch("pod")
_seated = lids.seated(_LID, "pod", *SEATED)
_is_shut = lids.shut_to(_LID, SHUT_ANGLE)
register_grasp("coffee")(_held)


@register_success("coffee")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Pod in the holder and not grasped, lid shut to 5 degrees, arm static."""
    left = _seated(points, info) & ~_held(points, info)
    return left & _is_shut(points, info) & (joint_speed(points, info, JOINT_SPEEDS) <= _STATIC)


_reach, _place, _shut = objects.reach("pod"), lids.placed(_LID, "pod"), lids.shut(_LID)
register_terms(  # minus the simulator's normalised shaped reward
    "coffee",
    shaped.normalised(
        6.0,
        {
            "placing": (None, 0.0, shaped.bring(_reach, _held, _place)),
            "shutting": (_seated, 3.0, shaped.let_go(_held, lambda p, i: 0.5 + 1.5 * _shut(p, i))),
        },
        _success,
    ),
)
register_stages(
    "coffee_plan",
    [
        sequences.insert("pod", _LID, _seated),
        sequences.close_lid(_LID, SHUT_ANGLE),
        sequences.rest(JOINT_SPEEDS, _STATIC),
    ],
    sequences.ALWAYS,
)


@dataclass(frozen=True)
class CoffeeExpert:
    """Grasp the pod from above, drop it into the holder, push the lid over from behind, press it."""

    speed: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> CoffeeExpert:
        """Expert of a random speed."""
        return cls(rng.uniform(0.020, 0.030))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (7,) for poses (6, 7) of hand, fingers, machine, lid and pod; there is no goal."""
        return Brew(poses, self.speed).act()


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill import ManiSkillSimulator, scenes  # noqa: F401  (registers the task)

    bodies = {**PANDA.links, "machine": "machine/machine", "lid": "machine/lid", "pod": "pod"}
    return ManiSkillSimulator("Coffee-v1", bodies, control=PANDA.control)


COFFEE = register_task(
    Task(
        name="Coffee",
        description="Put the pod into the machine's holder and shut the lid.",
        layout=_LAYOUT,
        robot=PANDA,
        simulator=_simulator,
        expert=CoffeeExpert.sample,
        expert_steps=140,
        cost="coffee",
        plan_cost="coffee_plan",
        planner="mppi-fine",
        success="coffee",
        grasp="coffee",
        max_episode_steps=210,
    )
)
