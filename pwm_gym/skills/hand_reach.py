"""A hand that is told joint targets brings the place before its palm somewhere, and bends its fingers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwm_gym.robots.adroit import Forearm, posture, tool_pose
from pwm_gym.scene.poses import turn_between

__all__ = ["HandReach"]

_DAMPING = 1e-3  # of the least squares, in squared metres: slides are used before turns
_FOREARM, _FINGER = 0, (4, 5)  # places among the entities: the forearm, and two links of the first finger


@dataclass(frozen=True)
class HandReach:
    """Brings the place before the palm somewhere, with its fingers bent by some share; keeps no memory."""

    arm: Forearm
    gain: float
    """How many times the way is asked for: weak drives go a part of it in a step, and sag under weights."""

    @staticmethod
    def place(poses: np.ndarray) -> np.ndarray:
        """The place (3,) before the palm, of entity poses (E, 7)."""
        return tool_pose(poses)[:3]

    @staticmethod
    def bent(poses: np.ndarray) -> float:
        """How far the first finger's middle joint is bent, 0 straight to 1, of entity poses (E, 7)."""
        upper, lower = (poses[k] for k in _FINGER)
        return turn_between(upper, lower) / (0.5 * np.pi)

    def act(
        self,
        poses: np.ndarray,
        target: np.ndarray,
        bend: float,
        wrist: np.ndarray,
        roll: float = 0.0,
        thumb: Sequence[float] | None = None,
    ) -> np.ndarray:
        """Action (A,).

        Args:
            poses: entity poses (E, 7), the hand's links first.
            target: where the place before the palm shall be (3,), metres.
            bend: of the fingers, 0 straight to 1.
            wrist: targets of the wrist's two joints in [-1, 1].
            roll: radians by which the forearm shall turn about itself beside the way.
            thumb: targets of the thumb's first two joints in [-1, 1]; None bends them with the fingers.
        """
        forearm, place = poses[_FOREARM], tool_pose(poses)[:3]
        jacobian = self.arm.jacobian(forearm, place)
        gram = jacobian @ jacobian.T + _DAMPING * np.eye(3)
        step = jacobian.T @ np.linalg.solve(gram, self.gain * (target - place))
        step[-1] += roll
        return posture(self.arm.targets(self.arm.joints(forearm) + step), wrist, bend, thumb)
