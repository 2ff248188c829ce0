"""OGBenchCubeSingle and OGBenchCubeDouble: bring each cube to its goal on the table, or on top of the other (OGBench).

OGBench is an extra; without it the tasks are known, and their simulators say what to install.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from torch import Tensor

from pwm_gym.costs import Points, register_grasp, register_success, register_terms, shaped, terms
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
_PRICE = 24.0  # of a cube that is not there, in the planners' cost: more than all else can differ


def _register_costs(name: str, cubes: tuple[str, ...]) -> None:
    """Reward, planning cost, success and grasp rules of a task, all called ``name``."""
    several, sure = Several(cubes, GOAL_RADIUS), Several(cubes, _SURE)
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
    register_terms(f"{name}_plan", _planned(sure))


def _planned(cubes: Several) -> dict[str, tuple[float, terms.Term]]:
    """Terms of planners: of the next cube, reach from above with open fingers, pinch, carry; of more, what is left."""
    of_next = cubes.of_next
    found: dict[str, tuple[float, terms.Term]] = {
        "approach": (1.5, of_next(lambda cube: terms.approach(cube, gripper=ROBOTIQ))),
        "premature_close": (4.0, of_next(lambda cube: terms.premature_close(cube, ROBOTIQ))),
        "finger_blocking": (3.0, of_next(lambda cube: terms.finger_blocking(cube, ROBOTIQ))),
        "misalignment": (2.0, of_next(lambda cube: terms.misalignment(cube, WIDTH))),
        "ground_contact": (1.0, terms.ground_contact),
        "carry": (-2.0, of_next(lambda cube: terms.carry(cube, cubes.target(cube), ROBOTIQ, _MOST, _FARTHEST))),
    }
    for cube in cubes.names:
        suffix = "" if len(cubes.names) == 1 else f"_{cube}"
        found[f"disturbance{suffix}"] = (0.5, terms.disturbance(cube, gripper=ROBOTIQ))
    if len(cubes.names) > 1:
        found["left"] = (_PRICE, cubes.left)
    return found


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
