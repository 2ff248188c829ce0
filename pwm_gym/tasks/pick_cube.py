"""PickCube: lift the cube from the table to a goal position in the air (ManiSkill ``PickCube-v1``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import Points, register_grasp, register_success, register_terms, shaped, terms
from pwm_gym.costs.motion import joint_speed
from pwm_gym.robots.panda import JOINT_SPEEDS, PANDA, layout
from pwm_gym.sim import Simulator
from pwm_gym.skills import TopGrasp, drive
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["PICK_CUBE", "PickCubeExpert"]

_WIDTH = 0.04  # metres
_GOAL_RADIUS = 0.025  # metres: ManiSkill's threshold for the cube's distance from the goal
_STATIC = 0.2  # rad/s: ManiSkill's threshold for the arm's fastest joint
_LAYOUT = layout({"cube": 300})

_at_goal = terms.near("cube", terms.goal_position, _GOAL_RADIUS)
register_grasp("pick_cube")(terms.near_and_shut("cube"))


@register_success("pick_cube")
def _success(points: Points, info: terms.Info) -> Tensor:
    """Cube within 2.5 cm of the goal and the arm static."""
    return _at_goal(points, info) & (joint_speed(points, info, JOINT_SPEEDS) <= _STATIC)


_REWARDS = {
    "reaching": terms.reach("cube"),
    "contact": terms.grasped("cube"),
    "placing": terms.place("cube", terms.goal_position),
    "static": terms.still(JOINT_SPEEDS, _at_goal),
}
_BONUS = shaped.success_bonus(_success, whole=5.0, parts=[*_REWARDS.values()])

register_terms(  # minus ManiSkill's normalised shaped reward; -1 at success
    "pick_cube", {name: (-0.2, term) for name, term in {**_REWARDS, "success": _BONUS}.items()}
)
register_terms(
    "pick_cube_plan",  # reach from above with open fingers, pinch, carry, settle
    {
        "approach": (1.5, terms.approach("cube")),
        "premature_close": (4.0, terms.premature_close("cube")),
        "finger_blocking": (3.0, terms.finger_blocking("cube")),
        "misalignment": (2.0, terms.misalignment("cube", _WIDTH)),
        "ground_contact": (1.0, terms.ground_contact),
        "effort": (1.0, terms.effort),
        "disturbance": (0.5, terms.disturbance("cube")),
        "carry": (-2.0, terms.carry("cube", terms.goal_position)),
        "settle": (0.3, terms.settle("cube", terms.goal_position, JOINT_SPEEDS, _STATIC)),
    },
)


@dataclass(frozen=True)
class PickCubeExpert:
    """Grasp from above, then carry to the goal."""

    grasp: TopGrasp

    @classmethod
    def sample(cls, rng: np.random.Generator) -> PickCubeExpert:
        """Expert of a random speed and hover height."""
        speed, hover = rng.uniform(0.0105, 0.018), rng.uniform(0.06, 0.10)
        return cls(TopGrasp(PANDA, _LAYOUT.index("cube"), _WIDTH, speed, hover))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (7,) for poses (4, 7) of hand, fingers and cube, and the cube's goal (3,)."""
        if self.grasp.holds(poses):
            return drive(PANDA, goal - poses[self.grasp.entity, :3], self.grasp.speed, gripper=-1.0)
        return self.grasp.act(poses)


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill import ManiSkillSimulator

    bodies = {**PANDA.links, "cube": "cube"}
    return ManiSkillSimulator("PickCube-v1", bodies, goal="goal_site", control=PANDA.control)


PICK_CUBE = register_task(
    Task(
        name="PickCube",
        description="Lift the cube from the table to a goal position in the air.",
        layout=_LAYOUT,
        goal_size=3,
        robot=PANDA,
        simulator=_simulator,
        expert=PickCubeExpert.sample,
        cost="pick_cube",
        plan_cost="pick_cube_plan",
        success="pick_cube",
        grasp="pick_cube",
    )
)
