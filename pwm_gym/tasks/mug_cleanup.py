"""MugCleanup: open the drawer, put the mug into it, shut it (a ManiSkill task of our own)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import (
    Points,
    drawers,
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
from pwm_gym.errors import PwmGymError
from pwm_gym.robots.panda import JOINT_SPEEDS, PANDA, layout
from pwm_gym.scene import FIXED
from pwm_gym.sim import Simulator
from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.sim.mugs import get_mug
from pwm_gym.skills import CleanUp
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["MUG_CLEANUP", "MugCleanupExpert"]

_SHUT, _STATIC = 0.008, 0.2  # metres, and rad/s: the simulator's thresholds
_JOINTS = {"cabinet": FIXED, "drawer": LOW_CABINET.joint}
_LAYOUT = layout({"cabinet": 2560, "drawer": 2560, "mug": 1536}, points=512, joints=_JOINTS)
_DRAWER = drawers.CABINET_DRAWER
_held = objects.held("mug")
_inside = drawers.inside(_DRAWER, "mug", edge=0.025, height=0.014)
_is_open = drawers.open_to(_DRAWER, LOW_CABINET.opened)
_is_shut = drawers.shut_to(_DRAWER, _SHUT)
register_grasp("mug_cleanup")(_held)  # by the rim, far from the mug's centre


@register_success("mug_cleanup")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Mug in the drawer and not grasped, drawer shut to 8 mm, arm static."""
    left = _inside(points, info) & ~_held(points, info)
    return left & _is_shut(points, info) & (joint_speed(points, info, JOINT_SPEEDS) <= _STATIC)


_handle, _opened = drawers.reach(drawers.handle(_DRAWER)), drawers.opened(_DRAWER)
_reach, _place = terms.reach("mug"), drawers.put_in(_DRAWER, "mug")
register_terms(  # minus the simulator's normalised shaped reward
    "mug_cleanup",
    shaped.normalised(
        8.0,
        {
            "opening": (None, 0.0, lambda p, i: _handle(p, i) + _opened(p, i)),
            "placing": (_is_open, 2.0, shaped.bring(_reach, _held, _place)),
            "shutting": (_inside, 5.0, shaped.let_go(_held, lambda p, i: 1.5 + 0.5 * _handle(p, i) - _opened(p, i))),
        },
        _success,
    ),
)
register_stages(
    "mug_cleanup_plan",
    [
        sequences.open_drawer(_DRAWER, LOW_CABINET.opened),
        sequences.put_in("mug", _DRAWER, _inside),
        sequences.close_drawer(_DRAWER, _SHUT),
        sequences.rest(JOINT_SPEEDS, _STATIC),
    ],
    sequences.ALWAYS,
)


@dataclass(frozen=True)
class MugCleanupExpert:
    """Pull or hook the drawer open, put the mug into it, held by its rim or about its body, push the drawer shut."""

    speed: float
    by_body: bool
    hooked: bool

    @classmethod
    def sample(cls, rng: np.random.Generator) -> MugCleanupExpert:
        """Expert of a random speed, grip and way to open; one in two hooks the handle."""
        return cls(rng.uniform(0.020, 0.030), bool(rng.random() < 0.5), bool(rng.random() < 0.5))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (7,) for poses (6, 7) of hand, fingers, cabinet, drawer and mug; there is no goal."""
        if not assets:
            raise PwmGymError("the expert of MugCleanup was given no assets; it grasps the mug by its size")
        return CleanUp(poses, get_mug(assets[_LAYOUT.index("mug")]), self.speed, self.by_body, self.hooked).act()


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill import ManiSkillSimulator
    from pwm_gym.sim.maniskill.scenes import MugChoice

    return ManiSkillSimulator(
        "MugCleanup-v1",
        {**PANDA.links, "cabinet": "cabinet/cabinet", "drawer": "cabinet/drawer", "mug": MugChoice.actor},
        control=PANDA.control,
        assets=MugChoice(),
    )


MUG_CLEANUP = register_task(
    Task(
        name="MugCleanup",
        description="Open the drawer, put the mug into it, and shut it.",
        layout=_LAYOUT,
        robot=PANDA,
        simulator=_simulator,
        expert=MugCleanupExpert.sample,
        expert_steps=280,
        cost="mug_cleanup",
        plan_cost="mug_cleanup_plan",
        planner="mppi-fine",
        success="mug_cleanup",
        grasp="mug_cleanup",
        max_episode_steps=420,
    )
)
