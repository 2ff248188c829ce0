"""OGBench's own oracle of its data collection, as an expert that reads poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError
from pwm_gym.robots.ur5e import opening, tool_pose
from pwm_gym.sim.mujoco.ogbench import WIDTH

__all__ = ["CubeOracle"]

_TOUCH = 0.004  # metres by which the pads may be farther apart and count as touching
_HELD = 0.03  # metres from the tool within which a cube is between the pads
_THERE = 0.02  # metres from its goal within which the oracle lets a cube go
_LOW = 0.16  # metres over the table that the oracle rises to
_BESIDE = 0.04  # metres beside a cube within which it is over it
_TAKEN = 0.03  # metres from a goal within which another cube takes its place
_SPOTS = np.array([[x, y, 0.02] for x in (0.32, 0.425, 0.53) for y in (-0.25, 0.0, 0.25)])  # metres, on the table
_WAITS = (0.425, 0.0, 0.3)  # metres: where the tool goes when all is done


@dataclass(frozen=True)
class CubeOracle:
    """``CubeMarkovOracle`` of OGBench: over the cube, down, grasp, up, over the goal, down, release, up.

    It asks for the force on a pad, which poses do not tell; pads as far apart as a cube that is between them count as
    pressing on it. Of several cubes it brings the one whose goal is lowest first, and rises from one that it has let go
    before it turns to the next; a cube whose goal is taken by another one is put aside.
    """

    cubes: tuple[int, ...]
    """Their places among the entities."""
    step: float
    """Length in metres of the way that the oracle asks for at least; larger is faster."""

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (5,) for poses (E, 7) and the cubes' goals (3 K,)."""
        goals = np.asarray(goal, float).reshape(-1, 3)
        told = self._told(poses, goals)
        action = _oracle(self.step, told["proprio/effector_yaw"][0]).select_action(None, told)
        return np.r_[action[:4], -action[4]].astype(np.float32)

    def _told(self, poses: np.ndarray, goals: np.ndarray) -> dict[str, Any]:
        """What the oracle reads of OGBench's environment."""
        tool = tool_pose(poses)
        places = poses[list(self.cubes), :3]
        stopped = opening(poses) < WIDTH + _TOUCH
        held = stopped & (np.linalg.norm(places - tool[:3], axis=1) < _HELD)
        targets = self._targets(places, goals)
        which = self._which(places, targets, goals, held, tool[:3])
        return {
            "proprio/effector_pos": tool[:3],
            "proprio/effector_yaw": np.array([_yaw(tool)]),
            "proprio/gripper_opening": np.zeros(1),
            "proprio/gripper_contact": np.array([float(held[which])]),
            "privileged/target_block": which,
            f"privileged/block_{which}_pos": places[which],
            f"privileged/block_{which}_yaw": np.array([_yaw(poses[self.cubes[which]])]),
            "privileged/target_block_pos": targets[which],
            "privileged/target_block_yaw": np.zeros(1),
        }

    @staticmethod
    def _targets(places: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Where the cubes go now (K, 3): their goals, or a free place meanwhile, where another cube is at the goal."""
        targets = goals.copy()
        for k, goal in enumerate(goals):
            ways = np.linalg.norm(np.delete(places, k, 0) - goal, axis=1)
            if ways.size and ways.min() < _TAKEN:
                spots = np.linalg.norm(_SPOTS[:, None] - goals, axis=-1).min(1)
                targets[k] = _SPOTS[spots.argmax()]
        return targets

    @staticmethod
    def _which(places: np.ndarray, targets: np.ndarray, goals: np.ndarray, held: np.ndarray, tool: np.ndarray) -> int:
        """The cube that it is about: one that it holds or is still over, or else the first that is not there."""
        there = np.linalg.norm(targets - places, axis=1) <= _THERE
        over = (np.linalg.norm(places[:, :2] - tool[:2], axis=1) < _BESIDE) & (tool[2] <= _LOW)
        if (busy := np.flatnonzero(held | (there & over))).size:
            return int(busy[0])
        away = (targets != goals).any(1)
        order = np.lexsort((goals[:, 2].round(3), away, there))  # not there, its goal free, its goal the lowest
        return int(order[0])


def _oracle(step: float, yaw: float) -> Any:
    """OGBench's oracle, which decides by what it is told alone.

    Args:
        step: as of :class:`CubeOracle`.
        yaw: turn of the tool, radians, that it keeps when all is done.
    """
    try:
        from ogbench.manipspace.oracles.markov.cube_markov import CubeMarkovOracle
    except ImportError as error:
        raise PwmGymError(f"{error}; OGBench's oracle needs it: pip install 'pwm-gym[ogbench]'") from error
    oracle = CubeMarkovOracle(env=None, min_norm=step)
    oracle._step, oracle._final_pos, oracle._final_yaw = 0, np.array(_WAITS), yaw  # its reset draws them
    return oracle


def _yaw(pose: np.ndarray) -> float:
    """Turn about the vertical, radians, of a pose (7,)."""
    x = Rotation.from_quat(pose[3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    return float(np.arctan2(x[1], x[0]))
