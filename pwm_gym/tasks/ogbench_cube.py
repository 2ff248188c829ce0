"""OGBenchCubeSingle and OGBenchCubeDouble: bring each cube to its goal on the table, or on top of the other (OGBench).

OGBench is an extra; without it the tasks are known, and their simulators say what to install.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from torch import Tensor

from pwm_gym.costs import Points, register_grasp, register_success, register_terms, shaped, terms
from pwm_gym.costs.placing import carry_onto
from pwm_gym.costs.rearranging import Rearranging
from pwm_gym.costs.several import Several
from pwm_gym.robots.gripper import ROBOTIQ
from pwm_gym.robots.ur5e import UR5E, layout
from pwm_gym.sim import Simulator
from pwm_gym.sim.mujoco.ogbench import GOAL_RADIUS, STARTS, WIDTH, cube_simulator
from pwm_gym.skills import CubeOracle
from pwm_gym.tasks.registry import Expert, Task, register_task

__all__ = ["OGBENCH_CUBE_DOUBLE", "OGBENCH_CUBE_SINGLE"]

_SURE = 0.02  # metres from its goal within which planners turn to the next cube
_MOST, _FARTHEST = 7.0, 0.7  # value of a held cube at its goal, and metres from there where holding it is worth least
_PRICE = 30.0  # of a move that is left, in the planners' cost: more than all else can differ
_OVER = 0.05  # metres that a cube is lifted beside its place, so that it passes over another one
_TABLE = (0.3, -0.3, 0.55, 0.3)  # metres: lowest and highest x and y where a cube can be put aside


def _register_costs(name: str, cubes: tuple[str, ...]) -> None:
    """Reward, planning cost, success and grasp rules of a task, all called ``name``."""
    several = Several(cubes, GOAL_RADIUS)
    success = register_success(name)(several.all_there)
    register_grasp(name)(several.any_of(lambda cube: terms.pinch(cube, ROBOTIQ)))

    def bring(cube: str) -> terms.Term:
        place = terms.nearness(terms.centre(cube), several.target(cube))
        return shaped.bring(terms.reach(cube, ROBOTIQ), terms.pinch(cube, ROBOTIQ), place)

    bringing = several.of_next(bring)
    whole = 4.0 * len(cubes)

    def done(points: Points, info: terms.Info) -> Tensor:
        return 4.0 * (len(cubes) - several.left(points, info)) + bringing(points, info)

    register_terms(name, shaped.normalised(whole, {"bringing": (None, 0.0, done)}, success))
    register_terms(f"{name}_plan", _planned_alone(*cubes) if len(cubes) == 1 else _planned(Several(cubes, _SURE)))


Weighted = dict[str, tuple[float, terms.Term]]
"""Name -> weight and term of a cost."""


def _planned_alone(cube: str) -> Weighted:
    """Terms of planners for a single cube: reach from above with open fingers, pinch, carry."""
    carry = terms.carry(cube, terms.goal_position, ROBOTIQ, _MOST, _FARTHEST)
    return {**_grasping(lambda make: make(cube)), "carry": (-2.0, carry), "disturbance": _still(cube)}


def _planned(cubes: Several) -> Weighted:
    """Terms of planners for several cubes: of the one that is next, and the moves that are left, whatever they are of.

    What a move is worth is more than all other terms can differ by.
    """
    rules = Rearranging(cubes, WIDTH, _TABLE)

    def carry(cube: str, place: terms.Place) -> terms.Term:
        return carry_onto(cube, place, _OVER, ROBOTIQ, _MOST, _FARTHEST)

    return {
        **_grasping(lambda make: rules.of_next(lambda cube, place: make(cube))),
        "carry": (-2.0, rules.of_next(carry)),
        **{f"disturbance_{cube}": _still(cube) for cube in cubes.names},
        "moves": (_PRICE, rules.moves),
    }


def _grasping(of: Callable[[Callable[[str], terms.Term]], terms.Term]) -> Weighted:
    """Terms that bring the gripper to a cube.

    Args:
        of: makes a term of what makes it for a cube's name.
    """
    return {
        "approach": (1.5, of(lambda cube: terms.approach(cube, gripper=ROBOTIQ))),
        "premature_close": (4.0, of(lambda cube: terms.premature_close(cube, ROBOTIQ))),
        "finger_blocking": (3.0, of(lambda cube: terms.finger_blocking(cube, ROBOTIQ))),
        "misalignment": (2.0, of(lambda cube: terms.misalignment(cube, WIDTH))),
        "ground_contact": (1.0, terms.ground_contact),
    }


def _still(cube: str) -> tuple[float, terms.Term]:
    return 0.5, terms.disturbance(cube, gripper=ROBOTIQ)


def _expert(entities: tuple[int, ...], rng: np.random.Generator) -> Expert:
    """OGBench's oracle, at a random speed."""
    return CubeOracle(entities, step=float(rng.choice([0.05, 0.1, 0.2, 0.3, 0.4])))


def _task(name: str, description: str, cubes: tuple[str, ...], steps: int, limit: int) -> Task:
    cost = f"ogbench_cube_{name.removeprefix('OGBenchCube').lower()}"
    _register_costs(cost, cubes)
    entities = layout(dict.fromkeys(cubes, 300))

    def simulator(starts: str = STARTS[0]) -> Simulator:
        return cube_simulator(cubes, starts)

    expert: Callable[[np.random.Generator], Expert] = partial(_expert, tuple(entities.index(cube) for cube in cubes))
    return register_task(
        Task(
            name=name,
            description=description,
            layout=entities,
            goal_size=3 * len(cubes),
            robot=UR5E,
            simulator=simulator,
            expert=expert,
            expert_steps=steps,
            starts=STARTS,
            cost=cost,
            plan_cost=f"{cost}_plan",
            success=cost,
            grasp=cost,
            max_episode_steps=limit,
        )
    )


OGBENCH_CUBE_SINGLE = _task(
    "OGBenchCubeSingle", "Bring the cube to its goal on the table.", ("cube",), steps=55, limit=200
)
OGBENCH_CUBE_DOUBLE = _task(
    "OGBenchCubeDouble",
    "Bring both cubes to their goals, which may be on top of each other.",
    ("cube_0", "cube_1"),
    steps=110,
    limit=500,
)
