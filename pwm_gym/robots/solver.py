"""Inverse kinematics of one serial arm in NumPy: what a simulator's controller solves at every step.

The same method as that of :class:`pwm_gym.robots.ArmKinematics`, for one arm at a time in a twentieth of the time.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots.control import SerialArm

__all__ = ["ArmSolver"]

_DAMPING = 1e-6  # of the least squares, in squared metres
_WHOLE_STEPS = 5
_CAREFUL_STEPS, _RATE = 8, 0.45  # where whole steps shoot past the solution
_EXACT = 1e-12  # square of an error, metres and radians, that is none
_SURE = 1e-4  # metres; what misses by more is sought again


class ArmSolver:
    """Kinematics of ``arm``; poses are matrices (4, 4) in the frame of all public poses, float64.

    Example:
        >>> from pwm_gym.robots.panda import PANDA
        >>> arm = PANDA.control.arms[0].chain
        >>> solver, rest = ArmSolver(arm), np.array(arm.rest)
        >>> joints, miss = solver.solve(solver.tool(rest), rest)
        >>> bool(miss < 1e-6)
        True
    """

    def __init__(self, arm: SerialArm) -> None:
        self.arm = arm
        origins = np.stack([_matrix(origin) for origin in arm.origins])
        across, other, along = np.zeros((3, 4, 4))
        along[2, 2] = along[3, 3] = 1.0
        across[0, 0] = across[1, 1] = 1.0
        other[0, 1], other[1, 0] = -1.0, 1.0
        # A joint's frame in the one before it: fixed + cosine * by_cosine + sine * by_sine.
        self._fixed, self._by_cosine, self._by_sine = origins @ along, origins @ across, origins @ other
        self._mount = _matrix(arm.mount) @ _matrix((*arm.tool, 1.0, 0.0, 0.0, 0.0))
        self._damping = _DAMPING * np.eye(6)

    def frames(self, joints: np.ndarray) -> np.ndarray:
        """Poses (J, 4, 4) of the joints' frames at angles (J,); each joint's axis is its frame's z."""
        angles = joints[:, None, None]
        local = self._fixed + np.cos(angles) * self._by_cosine + np.sin(angles) * self._by_sine
        for k in range(1, len(local)):
            local[k] = local[k - 1] @ local[k]
        return local

    def tool(self, joints: np.ndarray) -> np.ndarray:
        """The tool's pose (4, 4) at angles (J,)."""
        pose: np.ndarray = self.frames(joints)[-1] @ self._mount
        return pose

    def target(self, tool: np.ndarray, translation: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """The tool's pose (4, 4) after a translation (3,), metres, and turns (3,) about x, then y, then z, radians."""
        goal = tool.copy()
        (a, b, c), (x, y, z) = np.cos(angles).tolist(), np.sin(angles).tolist()
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, a, -x], [0.0, x, a]])
        about_y = np.array([[b, 0.0, y], [0.0, 1.0, 0.0], [-y, 0.0, b]])
        about_z = np.array([[c, -z, 0.0], [z, c, 0.0], [0.0, 0.0, 1.0]])
        goal[:3, :3] = about_x @ about_y @ about_z @ tool[:3, :3]
        goal[:3, 3] += translation
        return goal

    def solve(self, goal: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, float]:
        """Inverse kinematics.

        Args:
            goal: the tool's pose (4, 4).
            start: angles (J,) to begin at; the solution is close to them.

        Returns:
            Angles (J,), and the distance in metres by which the tool centre misses its goal.
        """
        joints, miss = self._approach(goal, start, _WHOLE_STEPS, 1.0)
        if not miss < _SURE:
            joints, _ = self._approach(goal, start, _CAREFUL_STEPS, _RATE)
            joints, miss = self._approach(goal, joints, _WHOLE_STEPS, 1.0)
        return joints, miss

    def _approach(self, goal: np.ndarray, joints: np.ndarray, steps: int, rate: float) -> tuple[np.ndarray, float]:
        """Angles (J,) after damped Gauss-Newton steps, and by how much they miss."""
        for _ in range(steps):
            frames = self.frames(joints)
            tool = frames[-1] @ self._mount
            error = _error(goal, tool)
            if float(error @ error) < _EXACT:
                return joints, float(np.linalg.norm(error[:3]))
            jacobian = _jacobian(frames, tool[:3, 3])
            gram = jacobian @ jacobian.T + self._damping
            joints = joints + rate * (jacobian.T @ np.linalg.solve(gram, error))
        return joints, float(np.linalg.norm(self.tool(joints)[:3, 3] - goal[:3, 3]))


def _matrix(pose: tuple[float, ...]) -> np.ndarray:
    """Pose (7,) as a matrix (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
    matrix[:3, 3] = pose[:3]
    return matrix


def _jacobian(frames: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(6, J): velocity of a point (3,) of the last link, and angular velocity, per joint velocity."""
    axes, arms = frames[:, :3, 2].T, point[:, None] - frames[:, :3, 3].T
    jacobian = np.empty((6, len(frames)))
    jacobian[:3] = axes[[1, 2, 0]] * arms[[2, 0, 1]] - axes[[2, 0, 1]] * arms[[1, 2, 0]]
    jacobian[3:] = axes
    return jacobian


def _error(goal: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """Way (6,) from the tool's pose to its goal: metres, and the turn's axis times its sine."""
    turned = goal[:3, :3] @ tool[:3, :3].T
    error = np.empty(6)
    error[:3] = goal[:3, 3] - tool[:3, 3]
    error[3] = 0.5 * (turned[2, 1] - turned[1, 2])
    error[4] = 0.5 * (turned[0, 2] - turned[2, 0])
    error[5] = 0.5 * (turned[1, 0] - turned[0, 1])
    return error
