"""TwoArmDrawerCleanup: one hand opens a drawer, the other puts a mug into it, the first shuts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import (
    Points,
    drawers,
    hand_drawers,
    hands,
    register_grasp,
    register_stages,
    register_success,
    register_terms,
    shaped,
    terms,
)
from pwm_gym.robots.two_hands import FLAT, HOLDING, TWO_HANDS, layout
from pwm_gym.scene import FIXED
from pwm_gym.sim import Simulator
from pwm_gym.sim.cabinets import DEEP_CABINET
from pwm_gym.skills import FillDrawer
from pwm_gym.tasks.registry import HandPosture, Task, register_task

__all__ = ["TWO_ARM_DRAWER_CLEANUP", "TwoArmDrawerCleanupExpert"]

_SHUT, _STATIC = 0.008, 0.2  # metres, and rad/s: the simulator's thresholds
_JOINTS = {"cabinet": FIXED, "drawer": DEEP_CABINET.joint}
_LAYOUT = layout({"cabinet": 3000, "drawer": 3000, "mug": 2000}, _JOINTS)
_DRAWER = hand_drawers.DEEP_DRAWER
_held = hand_drawers.held("mug")
_inside = drawers.inside(_DRAWER, "mug", edge=0.025, height=0.014)
_is_open = drawers.open_to(_DRAWER, DEEP_CABINET.opened)
_is_shut = drawers.shut_to(_DRAWER, _SHUT)
register_grasp("two_arm_drawer_cleanup")(_held)


@register_success("two_arm_drawer_cleanup")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Mug in the drawer and not held, drawer shut to 8 mm, arms static."""
    left = _inside(points, info) & ~_held(points, info)
    return left & _is_shut(points, info) & hands.static(_STATIC)(points, info)


_handle, _opened = hand_drawers.reach_handle("left", _DRAWER), drawers.opened(_DRAWER)
_reach, _place = hand_drawers.reach("right", "mug"), drawers.put_in(_DRAWER, "mug")
register_terms(  # minus the simulator's normalised shaped reward
    "two_arm_drawer_cleanup",
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
    "two_arm_drawer_cleanup_plan",
    hand_drawers.sequence(_DRAWER, "mug", _inside, DEEP_CABINET.opened, _SHUT, _STATIC),
    {
        "ground_contact": (1.0, hands.ground_contact),
        "tilt": (8.0, hands.tilted),
    },
)


@dataclass(frozen=True)
class TwoArmDrawerCleanupExpert:
    """Hook and pull with the left hand, take, carry and release with the right one, push with the left one."""

    speed: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> TwoArmDrawerCleanupExpert:
        """Expert of a random speed."""
        return cls(rng.uniform(0.013, 0.019))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (24,) for poses (25, 7) of both hands' links, cabinet, drawer and mug; there is no goal."""
        return FillDrawer(poses, self.speed).act()


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill.two_hands import two_hands_simulator

    return two_hands_simulator(
        "TwoArmDrawerCleanup-v1", {"cabinet": "cabinet/cabinet", "drawer": "cabinet/drawer", "mug": "mug"}
    )


TWO_ARM_DRAWER_CLEANUP = register_task(
    Task(
        name="TwoArmDrawerCleanup",
        description="Open the drawer with one hand, put the mug into it with the other, and shut it.",
        layout=_LAYOUT,
        robot=TWO_HANDS,
        simulator=_simulator,
        expert=TwoArmDrawerCleanupExpert.sample,
        expert_steps=250,
        cost="two_arm_drawer_cleanup",
        plan_cost="two_arm_drawer_cleanup_plan",
        planner="mppi-hands",
        postures={
            "left": HandPosture(hand_drawers.heading("left", _DRAWER), FLAT),
            "right": HandPosture(hand_drawers.heading("right", _DRAWER), (HOLDING[0], None, *HOLDING[2:])),
        },
        success="two_arm_drawer_cleanup",
        grasp="two_arm_drawer_cleanup",
        max_episode_steps=375,
    )
)
