"""StackCube: put the red cube on the green one and let it go (ManiSkill ``StackCube-v1``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwm_gym.robots import panda
from pwm_gym.scene import Layout, Support
from pwm_gym.sim import Simulator
from pwm_gym.skills import Place, TopGrasp
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["STACK_CUBE", "StackCubeExpert"]

_WIDTH = 0.04  # metres
_A, _B = 3, 4  # places of the cubes among the entities


@dataclass(frozen=True)
class StackCubeExpert:
    """Grasp the red cube, carry it over the green one, lower, release."""

    grasp: TopGrasp
    place: Place

    @classmethod
    def sample(cls, rng: np.random.Generator) -> StackCubeExpert:
        """Expert of a random speed, hover height and clearance."""
        speed = rng.uniform(0.0095, 0.019)
        grasp = TopGrasp(panda.PANDA, _A, _WIDTH, speed, hover=rng.uniform(0.06, 0.10), obstacles=(_B,))
        place = Place(panda.PANDA, _A, _WIDTH, speed, clearance=rng.uniform(0.02, 0.05))
        return cls(grasp, place)

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (7,) for poses (5, 7) of hand, fingers and both cubes; there is no goal."""
        target = poses[_B, :3] + [0.0, 0.0, _WIDTH]
        if self.place.placed(poses, target):
            return self.place.release(poses)
        if self.grasp.holds(poses):
            return self.place.carry(poses, target)
        return self.grasp.act(poses)


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill import ManiSkillSimulator

    bodies = {**panda.PANDA.links, "cube_a": "cubeA", "cube_b": "cubeB"}
    return ManiSkillSimulator(
        "StackCube-v1", bodies, control=panda.PANDA.control, robot_uids="panda", grasped="is_cubeA_grasped"
    )


STACK_CUBE = register_task(
    Task(
        name="StackCube",
        description="Put the red cube on the green one and let it go.",
        layout=Layout.build(
            [("hand", 300), ("left_gripper", 300), ("right_gripper", 300), ("cube_a", 300), ("cube_b", 300)],
            driven=panda.PANDA.driven,
            joints=panda.PANDA.joints,
            supports=[Support.ground()],
        ),
        robot=panda.PANDA,
        simulator=_simulator,
        expert=StackCubeExpert.sample,
        expert_steps=99,
        cost="stack_cube",
        plan_cost="stack_cube_plan",
        success="stack_cube",
        grasp="stack_cube",
    )
)
