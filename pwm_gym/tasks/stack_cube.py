"""StackCube: put the red cube on the green one and let it go (ManiSkill ``StackCube-v1``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import Points, placing, register_grasp, register_success, register_terms, shaped, terms
from pwm_gym.robots.panda import PANDA, layout
from pwm_gym.sim import Simulator
from pwm_gym.skills import Place, TopGrasp
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["STACK_CUBE", "StackCubeExpert"]

_WIDTH = 0.04  # metres
_PERIOD = PANDA.control.period
_LAYOUT = layout({"cube_a": 300, "cube_b": 300})

_ON_B = terms.on_top("cube_b", _WIDTH)
_stacked = terms.resting_on("cube_a", _ON_B, beside=0.5**0.5 * _WIDTH + 0.005, height=0.005)  # ManiSkill's thresholds
_at_rest = terms.at_rest("cube_a", _PERIOD, linear=0.01, angular=0.5)
_pinched = terms.pinch("cube_a")
register_grasp("stack_cube")(terms.near_and_shut("cube_a"))


@register_success("stack_cube")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Cube A on cube B, at rest, not grasped."""
    return _stacked(points, info) & _at_rest(points, info) & ~_pinched(points, info)


_reach = terms.reach("cube_a")
_place = terms.place("cube_a", _ON_B)
_ungrasp = terms.ungrasp("cube_a")
_still = terms.object_still("cube_a", _PERIOD)
register_terms(  # minus ManiSkill's normalised shaped reward, whose stages replace each other; -1 at success
    "stack_cube",
    shaped.stages(
        {
            "reaching": (None, lambda p, i: -0.25 * _reach(p, i)),
            "placing": (_pinched, lambda p, i: -0.5 - 0.125 * _place(p, i)),
            "releasing": (_stacked, lambda p, i: -0.75 - 0.0625 * (_ungrasp(p, i) + _still(p, i))),
            "success": (_success, lambda p, i: -_success(p, i).float()),
        }
    ),
)
_finished = placing.finished("cube_a", _ON_B)
register_terms(
    "stack_cube_plan",  # reach from above with open fingers, pinch, lift, carry over cube B, lower, release, retreat
    {
        "approach": (1.5, terms.approach("cube_a", _finished)),
        "premature_close": (4.0, terms.premature_close("cube_a")),
        "finger_blocking": (3.0, terms.finger_blocking("cube_a")),
        "misalignment": (2.0, terms.misalignment("cube_a", _WIDTH)),
        "ground_contact": (1.0, terms.ground_contact),
        "effort": (1.0, terms.effort),
        "disturbance": (0.5, terms.disturbance("cube_a")),
        "disturbance_b": (0.5, terms.disturbance("cube_b", held=False)),
        "carry": (-2.0, placing.carry_onto("cube_a", _ON_B)),
        "released": (-2.0, placing.released("cube_a", _ON_B)),
        "retreat": (0.5, placing.retreat("cube_a", _ON_B)),
    },
)


@dataclass(frozen=True)
class StackCubeExpert:
    """Grasp the red cube from above, carry it over the green one, lower, release."""

    grasp: TopGrasp
    place: Place

    @classmethod
    def sample(cls, rng: np.random.Generator) -> StackCubeExpert:
        """Expert of a random speed, hover height and clearance."""
        speed, hover, clearance = rng.uniform(0.011, 0.019), rng.uniform(0.06, 0.10), rng.uniform(0.02, 0.05)
        a, b = _LAYOUT.index("cube_a"), _LAYOUT.index("cube_b")
        return cls(TopGrasp(PANDA, a, _WIDTH, speed, hover, obstacles=(b,)), Place(PANDA, a, _WIDTH, speed, clearance))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (7,) for poses (5, 7) of hand, fingers and both cubes; there is no goal."""
        target = poses[_LAYOUT.index("cube_b"), :3] + [0.0, 0.0, _WIDTH]
        if self.place.placed(poses, target):
            return self.place.release(poses)
        if self.grasp.holds(poses):
            return self.place.carry(poses, target)
        return self.grasp.act(poses)


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill import ManiSkillSimulator

    bodies = {**PANDA.links, "cube_a": "cubeA", "cube_b": "cubeB"}
    return ManiSkillSimulator(
        "StackCube-v1", bodies, control=PANDA.control, robot_uids="panda", grasped="is_cubeA_grasped"
    )


STACK_CUBE = register_task(
    Task(
        name="StackCube",
        description="Put the red cube on the green one and let it go.",
        layout=_LAYOUT,
        robot=PANDA,
        simulator=_simulator,
        expert=StackCubeExpert.sample,
        expert_steps=99,
        cost="stack_cube",
        plan_cost="stack_cube_plan",
        success="stack_cube",
        grasp="stack_cube",
    )
)
