"""Joint positions and velocities of a MuJoCo model that put bodies where a scene says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.errors import SceneError
from pwm_gym.scene import within_limits
from pwm_gym.scene.poses import rotation

__all__ = ["JointSolver", "set_free_velocity"]

_STEPS = 30  # of Gauss-Newton; a single joint needs one, a chain with loops a handful
_SOLVED = 1e-12  # metres and radians of a step that ends it
_DAMPING = 1e-12
_OFF = (0.02, 0.1)  # metres and radians by which a body may miss its pose: models predict what joints do not allow


def set_free_velocity(data: Any, address: int, poses: np.ndarray, rate: float) -> None:
    """Give a free body the velocity that its poses (3, 7) at t, t-1, t-2 tell, of which the first two count.

    Args:
        data: MuJoCo's.
        address: where its velocities begin.
        poses: in the world's frame.
        rate: control steps per second.
    """
    now, before = rotation(poses[0]), rotation(poses[1])
    data.qvel[address : address + 3] = rate * (poses[0, :3] - poses[1, :3])
    data.qvel[address + 3 : address + 6] = rate * (before.inv() * now).as_rotvec()  # MuJoCo's are in the body's frame


@dataclass(frozen=True)
class JointSolver:
    """Finds joint positions by the poses of bodies that hang on them, with loops kept closed.

    Gauss-Newton over all joints at once, so that bodies may hang on each other and on chains of several joints.
    """

    model: Any
    dofs: np.ndarray
    """Degrees of freedom (D,) that are solved for."""
    bodies: tuple[int, ...]
    """Bodies whose poses are told."""

    def solve(self, data: Any, poses: np.ndarray) -> None:
        """Set the joints' positions in ``data`` for poses (K, 7) of the bodies in the world.

        Raises:
            SceneError: a body cannot be at its pose, or its joint would be beyond its limits.
        """
        import mujoco

        step = np.zeros(self.model.nv)
        for _ in range(_STEPS):
            mujoco.mj_fwdPosition(self.model, data)
            residual, jacobian = self._system(data, poses)
            square = jacobian.T @ jacobian + _DAMPING * np.eye(len(self.dofs))
            step[self.dofs] = np.linalg.solve(square, jacobian.T @ residual)
            mujoco.mj_integratePos(self.model, data.qpos, step, 1.0)
            if np.abs(step).max(initial=0.0) < _SOLVED:
                break
        self._limit(data)
        mujoco.mj_fwdPosition(self.model, data)
        self._check(data, poses)

    def velocities(self, data: Any, before: np.ndarray, rate: float) -> np.ndarray:
        """Velocities (D,) from positions (nq,) one control step ago to those in ``data``."""
        import mujoco

        velocity = np.zeros(self.model.nv)
        mujoco.mj_differentiatePos(self.model, velocity, 1.0 / rate, before, data.qpos)
        return velocity[self.dofs]

    def _system(self, data: Any, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (R,) of poses and loops, and its derivative (R, D) by the joints."""
        import mujoco

        residuals, rows = [], []
        shift, turn = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        for body, pose in zip(self.bodies, poses, strict=True):
            mujoco.mj_jacBody(self.model, data, shift, turn, body)
            residuals += [pose[:3] - data.xpos[body], _turn(data, body, pose)]
            rows += [shift[:, self.dofs], turn[:, self.dofs]]
        loops, derivative = self._loops(data)
        return np.concatenate([*residuals, -loops]), np.concatenate([*rows, derivative[:, self.dofs]])

    def _loops(self, data: Any) -> tuple[np.ndarray, np.ndarray]:
        """Violation (K,) of the model's equality constraints, and its derivative (K, nv)."""
        import mujoco

        if not data.nefc:
            return np.zeros(0), np.zeros((0, self.model.nv))
        matrix = np.zeros((data.nefc, self.model.nv))
        if mujoco.mj_isSparse(self.model):
            mujoco.mju_sparse2dense(matrix, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        else:
            matrix = np.asarray(data.efc_J).reshape(data.nefc, self.model.nv)
        rows = data.efc_type[: data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        return data.efc_pos[: data.nefc][rows].copy(), matrix[rows].copy()

    def _limit(self, data: Any) -> None:
        """Bring the joints within their limits.

        Raises:
            SceneError: one is far beyond them.
        """
        model = self.model
        for joint in {*model.dof_jntid[self.dofs].tolist()}:
            if not model.jnt_limited[joint] or model.jnt_dofadr[joint] not in _scalar_dofs(model):
                continue
            low, high = map(float, model.jnt_range[joint])
            address = model.jnt_qposadr[joint]
            name = model.joint(joint).name or model.body(int(model.jnt_bodyid[joint])).name
            data.qpos[address] = within_limits(f"joint {name!r}", float(data.qpos[address]), low, high)

    def _check(self, data: Any, poses: np.ndarray) -> None:
        for body, pose in zip(self.bodies, poses, strict=True):
            distance = float(np.linalg.norm(pose[:3] - data.xpos[body]))
            angle = float(np.linalg.norm(_turn(data, body, pose)))
            if distance > _OFF[0] or angle > _OFF[1]:
                raise SceneError(
                    f"body {self.model.body(body).name!r} cannot be where the scene has it: its joints bring it no "
                    f"nearer than {1000 * distance:.1f} mm and {angle:.3f} rad"
                )


def _turn(data: Any, body: int, pose: np.ndarray) -> np.ndarray:
    """Rotation vector (3,), world frame, from where a body points to where it shall point."""
    now = Rotation.from_quat(data.xquat[body], scalar_first=True)
    return (rotation(pose) * now.inv()).as_rotvec()


def _scalar_dofs(model: Any) -> set[int]:
    """Degrees of freedom of slide and hinge joints."""
    import mujoco

    scalar = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
    return {int(model.jnt_dofadr[k]) for k in range(model.njnt) if model.jnt_type[k] in scalar}
