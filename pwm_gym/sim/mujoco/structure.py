"""What a MuJoCo model is made of: which bodies a robot is, what its actuators drive, what is not supported."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError

__all__ = [
    "Hanging",
    "ancestors",
    "check_supported",
    "driven_roots",
    "hanging",
    "joint_type",
    "label",
    "moves",
    "scalar_joints",
]

_MOST_BODIES = 200
_ON_AXIS = 1e-9  # metres


@dataclass(frozen=True)
class Hanging:
    """How a body hangs on the entity above it."""

    parent: int | None
    """Body of that entity; None is the world."""
    joints: tuple[int, ...]
    """The joints between them, from the body upwards."""
    offset: np.ndarray
    """Point (3,) of the axis nearest to the body's origin, in its frame, if a single hinge is between them; else 0."""


def hanging(model: Any, body: int, entities: Collection[int]) -> Hanging:
    """How ``body`` hangs on the nearest of the ``entities`` (bodies) above it."""
    joints: list[int] = []
    link = body
    while link > 0 and (link == body or link not in entities):
        first = int(model.body_jntadr[link])
        joints += range(first, first + int(model.body_jntnum[link]))
        link = int(model.body_parentid[link])
    offset = np.zeros(3)
    if [model.jnt_type[k] for k in joints] == [joint_type("HINGE")]:
        offset = _beside(model, body, joints[0])
    return Hanging(link or None, tuple(joints), offset)


def _beside(model: Any, body: int, joint: int) -> np.ndarray:
    """Point (3,) of a hinge's axis nearest to the body's origin, in the body's frame; exactly 0 where it is on it."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    way = data.xanchor[joint] - data.xpos[body]
    way = way - (way @ data.xaxis[joint]) * data.xaxis[joint]
    offset = data.xmat[body].reshape(3, 3).T @ way
    return np.where(np.abs(offset) < _ON_AXIS, 0.0, offset)


def joint_type(name: str) -> int:
    """MuJoCo's number of a type of joint."""
    import mujoco

    return int(getattr(mujoco.mjtJoint, f"mjJNT_{name}"))


def scalar_joints(model: Any, joints: np.ndarray) -> np.ndarray:
    """Numbers (J,) of the robot's joints, all of one degree of freedom."""
    for joint in joints.tolist():
        if model.jnt_type[joint] not in (joint_type("SLIDE"), joint_type("HINGE")):
            name = model.joint(joint).name or f"number {joint}"
            body = model.body(int(model.jnt_bodyid[joint])).name
            raise PwmGymError(
                f"the robot's joint {name!r} of body {body!r} is free or a ball; expected slides and hinges in what "
                "actuators drive"
            )
    return joints


def label(element: Any) -> str:
    """What errors call an element of a model, such as ``model.body(3)``: its name, or else its number."""
    return repr(element.name or f"number {element.id}")


def moves(model: Any, body: int) -> bool:
    """Whether a body is not fixed to the world: it hangs on joints, or a mocap body takes it along."""
    return bool(model.body_weldid[body] or model.body_mocapid[model.body_rootid[body]] >= 0)


def ancestors(model: Any, body: int) -> list[int]:
    """A body and those that it hangs on, without the world."""
    found = []
    while body > 0:
        found.append(int(body))
        body = int(model.body_parentid[body])
    return found


def driven_roots(model: Any) -> set[int]:
    """Outermost moving bodies of the trees that an actuator or a mocap body drives."""
    import mujoco

    driven = [body for k in range(model.nu) for body in _actuated(model, k)]
    for k in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_WELD)):
        pair = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if any(model.body_mocapid[b] >= 0 for b in pair):
            driven += [b for b in pair if model.body_mocapid[b] < 0]
    moving = ([b for b in ancestors(model, body) if model.body_jntnum[b]] for body in driven)
    return {bodies[-1] for bodies in moving if bodies}


def _actuated(model: Any, actuator: int) -> list[int]:
    """Bodies that an actuator drives, through a joint, a tendon, a site or directly."""
    import mujoco

    kinds, target = mujoco.mjtTrn, int(model.actuator_trnid[actuator, 0])
    kind = int(model.actuator_trntype[actuator])
    if kind in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
        return [int(model.jnt_bodyid[target])]
    if kind == int(kinds.mjTRN_TENDON):
        first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
        wraps = range(first, first + count)
        joints = [k for k in wraps if model.wrap_type[k] == int(mujoco.mjtWrap.mjWRAP_JOINT)]
        sites = [k for k in wraps if model.wrap_type[k] == int(mujoco.mjtWrap.mjWRAP_SITE)]
        return [int(model.jnt_bodyid[model.wrap_objid[k]]) for k in joints] + [
            int(model.site_bodyid[model.wrap_objid[k]]) for k in sites
        ]
    if kind == int(kinds.mjTRN_BODY):
        return [target]
    return [int(model.site_bodyid[target])] if kind == int(kinds.mjTRN_SITE) else []


def check_supported(model: Any) -> None:
    """Refuse a model with something that is not supported.

    Raises:
        PwmGymError: naming it.
    """
    if model.nbody > _MOST_BODIES:
        raise PwmGymError(f"the model has {model.nbody} bodies; expected {_MOST_BODIES} at most")
    if model.nflex:
        import mujoco

        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, 0) or "number 0"
        raise PwmGymError(f"the model has a flexible body {name!r}; expected rigid ones")
