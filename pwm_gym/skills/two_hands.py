"""Motions of two hands that hang upright: each tool's way, the turn that keeps it upright, its fingers' targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots import two_hands
from pwm_gym.scene.poses import rotation

__all__ = ["FLAT", "Reach", "act", "upright"]

_GAIN = 1.5  # of the servo: the controller lags and makes a part of what it is asked for
_FASTEST_TURN = 0.07  # radians a step
FLAT = np.array(two_hands.FLAT)


@dataclass(frozen=True)
class Reach:
    """What one hand shall do in a step."""

    target: np.ndarray
    """Place (3,) of its tool, base frame, metres."""
    normal: np.ndarray
    """Horizontal direction (3,) that its palm shall face."""
    speed: float
    """Longest translation asked for in a step, metres."""
    fingers: np.ndarray
    """Targets (6,) in [-1, 1]."""
    push: np.ndarray | None = None
    """Further translation (3,) asked for in every step, metres: what presses on something."""


def act(poses: np.ndarray, reaches: Mapping[str, Reach]) -> np.ndarray:
    """Action (24,) for poses (E, 7) that begin with the robot's links, of what the left and the right hand shall do."""
    moves = {}
    for side, reach in reaches.items():
        tool = two_hands.tool_pose(poses, side)
        offset = reach.target - tool[:3]
        step = offset * min(_GAIN, reach.speed / max(float(np.linalg.norm(offset)), 1e-9))
        turn = _GAIN * upright(tool, reach.normal)
        turn *= min(1.0, _FASTEST_TURN / max(float(np.linalg.norm(turn)), 1e-9))
        moves[side] = (step if reach.push is None else step + reach.push, turn, reach.fingers)
    return two_hands.action(moves)


def upright(tool: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) that points the fingers of a tool (7,) down and its palm along a horizontal direction."""
    x = np.array([normal[0], normal[1], 0.0]) / max(float(np.hypot(normal[0], normal[1])), 1e-9)
    down = np.array([0.0, 0.0, -1.0])
    wanted = Rotation.from_matrix(np.stack([x, np.cross(down, x), down], -1))
    return (wanted * rotation(tool).inv()).as_rotvec()
