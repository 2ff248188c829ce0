"""CoffeePreparation: the mug to the machine, the pod out of the drawer into the holder, the lid shut (of our own).

Its planning cost is a sequence of the stages of other tasks, and no term of it is its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    terms,
)
from pwm_gym.costs.motion import joint_speed
from pwm_gym.robots.panda import JOINT_SPEEDS, PANDA, layout
from pwm_gym.scene import FIXED
from pwm_gym.sim import Simulator
from pwm_gym.sim.cabinet import DRAWER_JOINT
from pwm_gym.sim.coffee_machine import LID_JOINT
from pwm_gym.sim.mugs import get_mug
from pwm_gym.skills import Prepare
from pwm_gym.tasks.coffee import SHUT
from pwm_gym.tasks.mug_cleanup import OPEN
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["COFFEE_PREPARATION", "CoffeePreparationExpert"]

_STATIC = 0.2  # rad/s: the simulator's threshold
_JOINTS = {"machine": FIXED, "lid": LID_JOINT, "cabinet": FIXED, "drawer": DRAWER_JOINT}
_POINTS = {"machine": 1408, "lid": 640, "pod": 512, "cabinet": 1536, "drawer": 1536, "mug": 1024}
_LAYOUT = layout(_POINTS, points=512, joints=_JOINTS)
_LID, _DRAWER = lids.COFFEE_LID, drawers.CABINET_DRAWER
_holds_mug, _holds_pod = objects.held("mug"), terms.pinch("pod")
_stand, _holder = lids.before(_LID, "mug"), lids.holder(_LID)
_stands = terms.resting_on("mug", _stand, beside=0.02, height=0.006)
_seated = lids.seated(_LID, "pod", beside=0.006, above=0.008)
_is_open, _is_shut = drawers.open_to(_DRAWER, OPEN), lids.shut_to(_LID, SHUT)
register_grasp("coffee_preparation")(_holds_pod)


@register_success("coffee_preparation")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Mug before the machine, pod in the holder, neither grasped, lid shut to 5 degrees, arm static."""
    left = ~_holds_mug(points, info) & ~_holds_pod(points, info) & _stands(points, info) & _seated(points, info)
    return left & _is_shut(points, info) & (joint_speed(points, info, JOINT_SPEEDS) <= _STATIC)


_to_mug, _to_stand = terms.reach("mug"), terms.nearness(terms.centre("mug"), _stand)
_to_pod, _to_holder = objects.reach("pod"), lids.placed(_LID, "pod")
_to_handle, _opened = drawers.reach(drawers.handle(_DRAWER)), drawers.opened(_DRAWER)
_shut = lids.shut(_LID)


def _bringing(points: Points, info: terms.Info) -> Tensor:
    """Reward for reaching the mug, holding it, and bringing it to the machine."""
    return _to_mug(points, info) + _holds_mug(points, info) * (1.0 + _to_stand(points, info))


def _opening(points: Points, info: terms.Info) -> Tensor:
    """Reward for letting the mug go, reaching the handle, and opening the drawer."""
    return 3.0 + ~_holds_mug(points, info) * (_to_handle(points, info) + _opened(points, info))


def _inserting(points: Points, info: terms.Info) -> Tensor:
    """Reward for reaching the pod, holding it, and bringing it to the holder."""
    return 5.0 + _to_pod(points, info) + _holds_pod(points, info) * (1.0 + _to_holder(points, info))


def _shutting(points: Points, info: terms.Info) -> Tensor:
    """Reward for letting the pod go and shutting the lid."""
    return 8.0 + ~_holds_pod(points, info) * (0.5 + 1.5 * _shut(points, info))


register_terms(  # minus the simulator's normalised shaped reward, whose stages replace each other
    "coffee_preparation",
    terms.stages(
        {
            "bringing": (None, lambda p, i: -_bringing(p, i) / 11.0),
            "opening": (_stands, lambda p, i: -_opening(p, i) / 11.0),
            "inserting": (lambda p, i: _stands(p, i) & _is_open(p, i), lambda p, i: -_inserting(p, i) / 11.0),
            "shutting": (lambda p, i: _stands(p, i) & _seated(p, i), lambda p, i: -_shutting(p, i) / 11.0),
            "success": (_success, lambda p, i: -_success(p, i).float()),
        }
    ),
)
register_stages(
    "coffee_preparation_plan",
    [
        sequences.place("mug", "machine", _stand, _stands),
        sequences.open_drawer(_DRAWER, OPEN),
        sequences.take("pod", 0.06, until=_seated),
        sequences.insert("pod", _LID, beside=0.006, above=0.008),
        sequences.close_lid(_LID, SHUT),
    ],
    {"ground_contact": (1.0, terms.ground_contact), "effort": (1.0, terms.effort)},
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

    bodies = {
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
        success="coffee_preparation",
        grasp="coffee_preparation",
        max_episode_steps=500,
    )
)
