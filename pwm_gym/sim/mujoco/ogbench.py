"""The Cube tasks of OGBench as simulators."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError, unknown_name
from pwm_gym.robots.ur5e import UR5E, opening, tool_pose
from pwm_gym.sim.mujoco.adapter import MujocoSimulator
from pwm_gym.sim.mujoco.ogbench_play import PlayStart, start_in_play
from pwm_gym.sim.nearness import near
from pwm_gym.sim.protocol import Past, SimOutcome

__all__ = ["GOAL_RADIUS", "STARTS", "WIDTH", "CubeSimulator", "CubeWorld", "cube_simulator"]

GOAL_RADIUS = 0.04
"""Metres from its goal within which a cube is there."""
WIDTH = 0.04
"""Metres: a cube's side."""
STARTS = ("random", "tasks", "task1", "task2", "task3", "task4", "task5", "play")
"""Where episodes start: cubes and goals anywhere on the table; OGBench's five evaluation tasks in turn; one of them; in
the midst of play, with a goal 25 steps ahead (:mod:`.ogbench_play`)."""

_VARIANTS = {1: "single", 2: "double"}
_LOW, _HIGH = (0.3, -0.3), (0.55, 0.3)  # metres: where OGBench's data collection puts cubes and goals
_APART = 0.08  # metres between cubes, and between their goals, that leave room for fingers
_MOVED = 0.06  # metres from a cube to its goal, at least
_STACKED, _STAYS = 0.4, 0.2  # of random episodes with two cubes: goals on top of each other, a cube that is there


class CubeWorld:
    """OGBench's Cube environment, which steps its model itself.

    The gripper's component of an action is turned round: 1 opens it, as for all robots here, and -1 shuts it. The goal
    is the cubes' positions in a row (3 K,). What came before a start in the midst of play is in ``play``.

    Args:
        cubes: 1 or 2.
        starts: one of :data:`STARTS`; of "tasks", the episode of a seed is that of task 1 + seed modulo 5.

    Raises:
        UnknownNameError: there are no such starts.
        PwmGymError: OGBench is not installed, or has no such environment.
    """

    def __init__(self, cubes: int = 1, starts: str = STARTS[0]) -> None:
        if starts not in STARTS:
            raise unknown_name("starts", starts, STARTS)
        if cubes not in _VARIANTS:
            raise PwmGymError(f"cubes={cubes}; expected 1 or 2")
        self._cubes, self._starts = cubes, starts
        self.env = _make(_VARIANTS[cubes])
        with _quietly():
            self.env.reset(seed=0, options={"task_id": 1})  # which makes the model
        self.play: PlayStart | None = None
        self.model, self.data = self.env.model, self.env.data
        self.action_size = len(self.env.action_low)
        self.period = float(self.env.control_timestep())
        self._home = self.data.qpos.copy()
        self._targets = [int(self.model.body(f"object_target_{k}").mocapid[0]) for k in range(cubes)]

    def reset(self, seed: int) -> None:
        """Start the episode of ``seed``, with OGBench's own noise: places by 1 cm, any turn, the arm anywhere."""
        self.play = None
        with _quietly():
            if self._starts != "play":
                self.env.reset(seed=int(seed), options=self._options(int(seed)))
                return
            self.play = start_in_play(self.env, int(seed))
        self.set_goal(self.play.goal)

    def _options(self, seed: int) -> dict[str, Any]:
        """What OGBench's reset is told of an episode."""
        if self._starts == "random":
            return {"task_info": _draw(self._cubes, np.random.default_rng(seed))}
        if self._starts == "tasks":
            return {"task_id": 1 + seed % 5}
        return {"task_id": int(self._starts.removeprefix("task"))}

    def clear(self) -> None:
        """Go to a state that is always the same."""
        import mujoco

        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self._home

    def step(self, action: np.ndarray) -> None:
        """The environment's own step."""
        self.env.step(_turned(action))

    def goal(self) -> np.ndarray:
        """Where the cubes shall be (3 K,)."""
        return self.data.mocap_pos[self._targets].ravel().copy()

    def set_goal(self, goal: np.ndarray) -> None:
        """Move the targets to ``goal`` (3 K,)."""
        self.data.mocap_pos[self._targets] = np.reshape(goal, (-1, 3))

    def close(self) -> None:
        """Give the environment back; calling it twice is harmless."""
        if self.env is not None:
            self.env.close()
            _FREE.setdefault(_VARIANTS[self._cubes], []).append(self.env)
            self.env = None


_FREE: dict[str, list[Any]] = {}
"""Closed environments of each variant: compiling the model of one takes seconds."""


def _make(variant: str) -> Any:
    """OGBench's environment in its evaluation mode, whose episodes do not end by themselves."""
    if _FREE.get(variant):
        return _FREE[variant].pop()
    with _quietly():
        try:
            from ogbench.manipspace.envs.cube_env import CubeEnv
        except ImportError as error:
            raise PwmGymError(f"{error}; OGBench's tasks need it: pip install 'pwm-gym[ogbench]'") from error
        return CubeEnv(variant, mode="task", terminate_at_goal=False, visualize_info=False)


@contextmanager
def _quietly() -> Iterator[None]:
    """Without warnings of a missing display and of spaces' precision."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _turned(action: np.ndarray) -> np.ndarray:
    """OGBench's action of ours (5,), or ours of OGBench's: the gripper's component has the other sign."""
    return np.r_[action[:-1], -action[-1]]


def _draw(cubes: int, rng: np.random.Generator) -> dict[str, Any]:
    """Random places and goals of the cubes, none of which is solved at the start."""
    starts = _spread(cubes, rng)
    while True:
        goals = _spread(cubes, rng)
        if cubes > 1 and rng.random() < _STACKED:
            goals[1] = goals[0] + [0.0, 0.0, WIDTH]
        elif cubes > 1 and rng.random() < _STAYS:
            goals[0] = starts[0]
            if np.linalg.norm(goals[1] - goals[0]) < _APART:
                continue
        if np.linalg.norm(goals - starts, axis=1).max() > _MOVED:
            return {"task_name": "random", "init_xyzs": starts, "goal_xyzs": goals}


def _spread(cubes: int, rng: np.random.Generator) -> np.ndarray:
    """Places (K, 3) of cubes on the table, apart from each other."""
    while True:
        places = np.c_[rng.uniform(_LOW, _HIGH, (cubes, 2)), np.full(cubes, 0.5 * WIDTH)]
        ways = np.linalg.norm(places[:, None] - places, axis=-1)
        if cubes == 1 or ways[np.triu_indices(cubes, 1)].min() > _APART:
            return places


class CubeSimulator(MujocoSimulator):
    """A Cube task; it tells what came before a start in the midst of play."""

    world: CubeWorld

    def past(self) -> Past | None:
        """Poses and action before the episode's start; None where it starts at rest."""
        import mujoco

        play, poses = self.world.play, []
        if play is None or play.action is None:
            return None
        data = mujoco.MjData(self.model)
        for positions in play.positions:
            data.qpos[:] = positions
            mujoco.mj_kinematics(self.model, data)
            poses.append(self.poses(data))
        return Past(np.stack(poses), _turned(play.action).astype(np.float32))


def cube_simulator(cubes: Sequence[str], starts: str = STARTS[0]) -> CubeSimulator:
    """A Cube task, whose success rule is OGBench's: all cubes within 4 cm of their goals.

    The reward is dense, in [0, 1]: of each cube that is at its goal a share, of the next one parts of that for
    reaching, holding and bringing it; success is worth 1.

    Args:
        cubes: what the cubes' entities are called.
        starts: one of :data:`STARTS`.
    """

    def judge(simulator: MujocoSimulator) -> SimOutcome:
        goals = simulator.goal().astype(float).reshape(-1, 3)
        places = np.stack([simulator.pose(name)[:3] for name in cubes])
        there = np.linalg.norm(goals - places, axis=1) <= GOAL_RADIUS
        held = [_held(simulator, name) for name in cubes]
        if there.all():
            return SimOutcome(1.0, True, any(held))
        k = int(np.lexsort((goals[:, 2].round(3), there))[0])  # the next one: not there, its goal the lowest
        reach = near(tool_pose(simulator.poses())[:3], places[k])
        reward = 4.0 * there.sum() + reach + held[k] * (1.0 + near(places[k], goals[k]))
        return SimOutcome(float(reward) / (4.0 * len(cubes)), False, any(held))

    bodies = {**UR5E.links, **{name: f"object_{k}" for k, name in enumerate(cubes)}}
    return CubeSimulator(CubeWorld(len(cubes), starts), bodies, judge, control=UR5E.control)


def _held(simulator: MujocoSimulator, name: str) -> bool:
    """Whether both fingers touch a cube, and are not shut."""
    touched = all(simulator.touching(finger, name) for finger in ("left_gripper", "right_gripper"))
    return touched and opening(simulator.poses()) > 0.5 * WIDTH
