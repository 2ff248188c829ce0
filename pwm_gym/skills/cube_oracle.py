"""OGBench's own oracle of its data collection, as an expert that reads poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError
from pwm_gym.robots.ur5e import opening, tool_pose

__all__ = ["CubeOracle"]

_WIDTH = 0.04  # metres: a cube's side
_TOUCH = 0.004  # metres by which the pads may be farther apart and count as touching
_HELD = 0.03  # metres from the tool within which a cube is between the pads
_THERE = 0.02  # metres from its goal within which the oracle lets a cube go
_LOW, _BESIDE = (
    0.16,
    0.04,
)  # metres: height over the table that the oracle rises to, and beside a cube when it is over it
_WAITS = (0.425, 0.0, 0.3)  # metres: where the tool goes when all is done


@dataclass(frozen=True)
class CubeOracle:
    """``CubeMarkovOracle`` of OGBench: over the cube, down, grasp, up, over the goal, down, release, up.

    It asks for the force on a pad, which poses do not tell; pads as far apart as a cube that is between them count as
    pressing on it. Of several cubes it brings the one whose goal is lowest first, and rises from one that it has let go
    before it turns to the next.
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
        which = self._which(poses, goals, tool[:3])
        cube = poses[self.cubes[which]]
        stopped = opening(poses) < _WIDTH + _TOUCH and np.linalg.norm(cube[:3] - tool[:3]) < _HELD
        return {
            "proprio/effector_pos": tool[:3],
            "proprio/effector_yaw": np.array([_yaw(tool)]),
            "proprio/gripper_opening": np.zeros(1),
            "proprio/gripper_contact": np.array([float(stopped)]),
            "privileged/target_block": which,
            f"privileged/block_{which}_pos": cube[:3],
            f"privileged/block_{which}_yaw": np.array([_yaw(cube)]),
            "privileged/target_block_pos": goals[which],
            "privileged/target_block_yaw": np.zeros(1),
        }

    def _which(self, poses: np.ndarray, goals: np.ndarray, tool: np.ndarray) -> int:
        """The cube that it is about: one that it is still over, or else the first that is not there."""
        places = poses[list(self.cubes), :3]
        there = np.linalg.norm(goals - places, axis=1) <= _THERE
        over = (np.linalg.norm(places[:, :2] - tool[:2], axis=1) < _BESIDE) & (tool[2] <= _LOW)
        if (left := np.flatnonzero(there & over)).size:
            return int(left[0])
        order = np.lexsort((goals[:, 2].round(3), there))  # those that are not there first, the lowest goal first
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
