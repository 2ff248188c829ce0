"""TwoArmBoxCleanup: two hands take a box's lid and put it on the box (a ManiSkill task of our own)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import (
    Points,
    box_lids,
    hands,
    register_grasp,
    register_stages,
    register_success,
    register_terms,
    shaped,
    terms,
)
from pwm_gym.robots.two_hands import FLAT, SIDES, TWO_HANDS, layout
from pwm_gym.sim import Simulator
from pwm_gym.skills import PutLid
from pwm_gym.tasks.registry import HandPosture, Task, register_task

__all__ = ["TWO_ARM_BOX_CLEANUP", "TwoArmBoxCleanupExpert"]

_LEFT, _STATIC = 0.020, 0.2  # metres, and rad/s: the simulator's thresholds
_LAYOUT = layout({"box": 3000, "lid": 3000})
_LID = box_lids.LIDDED_BOX
_held = box_lids.held(_LID)
_seated = box_lids.seated(_LID)
_released = box_lids.released(_LID, _LEFT)
_reach, _brought = box_lids.reach(_LID), box_lids.brought(_LID)
register_grasp("two_arm_box_cleanup")(_held)


@register_success("two_arm_box_cleanup")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Lid on the box, both hands 2 cm from it, arms static."""
    return _seated(points, info) & _released(points, info) & hands.static(_STATIC)(points, info)


register_terms(  # minus the simulator's normalised shaped reward
    "two_arm_box_cleanup",
    shaped.normalised(
        5.0,
        {
            "bringing": (None, 0.0, shaped.bring(_reach, _held, _brought)),
            "leaving": (_seated, 3.0, box_lids.apart(_LID, _LEFT)),
        },
        _success,
    ),
)
register_stages(
    "two_arm_box_cleanup_plan",
    box_lids.sequence(_LID, _LEFT, _STATIC),
    {
        "ground_contact": (1.0, hands.ground_contact),
        "tilt": (8.0, hands.tilted),
    },
)


@dataclass(frozen=True)
class TwoArmBoxCleanupExpert:
    """Both hands beside the lid, in, up, over the box, down, out."""

    speed: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> TwoArmBoxCleanupExpert:
        """Expert of a random speed."""
        return cls(rng.uniform(0.011, 0.016))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (24,) for poses (24, 7) of both hands' links, box and lid; there is no goal."""
        return PutLid(poses, self.speed).act()


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill.two_hands import two_hands_simulator

    return two_hands_simulator("TwoArmBoxCleanup-v1", {"box": "box", "lid": "lid"})


TWO_ARM_BOX_CLEANUP = register_task(
    Task(
        name="TwoArmBoxCleanup",
        description="Take the lid between two hands and put it on the box.",
        layout=_LAYOUT,
        robot=TWO_HANDS,
        simulator=_simulator,
        expert=TwoArmBoxCleanupExpert.sample,
        expert_steps=185,
        cost="two_arm_box_cleanup",
        plan_cost="two_arm_box_cleanup_plan",
        planner="mppi-pair",
        postures={side: HandPosture(box_lids.heading(_LID, side), FLAT) for side in SIDES},
        success="two_arm_box_cleanup",
        grasp="two_arm_box_cleanup",
        max_episode_steps=280,
    )
)
