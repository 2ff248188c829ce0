"""CoffeePreparation: the mug to the machine, the pod out of the drawer into the holder, the lid shut (of our own).

Its planning cost is a sequence of the stages of other tasks, and no term of it is its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from torch import Tensor

from pwm_gym.costs import (
    Points,
    drawers,
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
from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.sim.coffee_machine import LID_JOINT, SEATED, SHUT_ANGLE
from pwm_gym.sim.mugs import get_mug
from pwm_gym.skills import Prepare
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["COFFEE_PREPARATION", "CoffeePreparationExpert"]

_STATIC = 0.2  # rad/s: the simulator's threshold
_JOINTS = {"machine": FIXED, "lid": LID_JOINT, "cabinet": FIXED, "drawer": LOW_CABINET.joint}
_POINTS = {"machine": 1408, "lid": 640, "pod": 512, "cabinet": 1536, "drawer": 1536, "mug": 1024}
_LAYOUT = layout(_POINTS, points=512, joints=_JOINTS)
_LID, _DRAWER = lids.COFFEE_LID, drawers.CABINET_DRAWER
_holds_mug, _holds_pod = objects.held("mug"), terms.pinch("pod")
_stand = lids.before(_LID, "mug")
_stands = terms.resting_on("mug", _stand, beside=0.02, height=0.006)
_placed = terms.resting_on("mug", _stand, beside=0.012, height=0.006)  # its axis, which counts, is off its cloud's mean
_seated = lids.seated(_LID, "pod", *SEATED)
_is_open, _is_shut = drawers.open_to(_DRAWER, LOW_CABINET.opened), lids.shut_to(_LID, SHUT_ANGLE)
register_grasp("coffee_preparation")(_holds_pod)


@register_success("coffee_preparation")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Mug before the machine, pod in the holder, neither grasped, lid shut to 5 degrees, arm static."""
    left = ~_holds_mug(points, info) & ~_holds_pod(points, info) & _stands(points, info) & _seated(points, info)
    return left & _is_shut(points, info) & (joint_speed(points, info, JOINT_SPEEDS) <= _STATIC)


_handle, _opened, _shut = drawers.reach(drawers.handle(_DRAWER)), drawers.opened(_DRAWER), lids.shut(_LID)
_bring_mug = shaped.bring(terms.reach("mug"), _holds_mug, terms.nearness(terms.centre("mug"), _stand))
_bring_pod = shaped.bring(objects.reach("pod"), _holds_pod, lids.placed(_LID, "pod"))
register_terms(  # minus the simulator's normalised shaped reward
    "coffee_preparation",
    shaped.normalised(
        11.0,
        {
            "bringing": (None, 0.0, _bring_mug),
            "opening": (_stands, 3.0, shaped.let_go(_holds_mug, lambda p, i: _handle(p, i) + _opened(p, i))),
            "inserting": (lambda p, i: _stands(p, i) & _is_open(p, i), 5.0, _bring_pod),
            "shutting": (
                lambda p, i: _stands(p, i) & _seated(p, i),
                8.0,
                shaped.let_go(_holds_pod, lambda p, i: 0.5 + 1.5 * _shut(p, i)),
            ),
        },
        _success,
    ),
)
register_stages(
    "coffee_preparation_plan",
    [
        replace(sequences.place("mug", "machine", _stand, _placed), lasting=_stands),
        sequences.leave("mug"),
        sequences.open_drawer(_DRAWER, LOW_CABINET.opened),
        sequences.take_out("pod", _DRAWER, 0.06, until=_seated),
        sequences.insert("pod", _LID, _seated),
        sequences.close_lid(_LID, SHUT_ANGLE),
        sequences.rest(JOINT_SPEEDS, _STATIC),
    ],
    sequences.ALWAYS,
)


@dataclass(frozen=True)
class CoffeePreparationExpert:
    """Bring the mug to the machine, pull the drawer open, drop its pod into the holder, push the lid shut."""

    speed: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> CoffeePreparationExpert:
        """Expert of a random speed."""
        return cls(rng.uniform(0.020, 0.030))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (7,) for poses (9, 7) of hand, fingers, machine, lid, pod, cabinet, drawer and mug; no goal."""
        return Prepare(poses, get_mug(assets[_LAYOUT.index("mug")]), self.speed).act()


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill import ManiSkillSimulator
    from pwm_gym.sim.maniskill.scenes import MugChoice

    bodies: dict[str, str | Callable[[Any], Any]] = {
        **PANDA.links,
        "machine": "machine/machine",
        "lid": "machine/lid",
        "pod": "pod",
        "cabinet": "cabinet/cabinet",
        "drawer": "cabinet/drawer",
        "mug": MugChoice.actor,
    }
    return ManiSkillSimulator("CoffeePreparation-v1", bodies, control=PANDA.control, assets=MugChoice())


COFFEE_PREPARATION = register_task(
    Task(
        name="CoffeePreparation",
        description="Bring the mug to the machine, put the drawer's pod into its holder, and shut the lid.",
        layout=_LAYOUT,
        robot=PANDA,
        simulator=_simulator,
        expert=CoffeePreparationExpert.sample,
        expert_steps=330,
        cost="coffee_preparation",
        plan_cost="coffee_preparation_plan",
        planner="mppi-fine",
        success="coffee_preparation",
        grasp="coffee_preparation",
        max_episode_steps=500,
    )
)
