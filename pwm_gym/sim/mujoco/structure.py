"""What a MuJoCo model is made of: which bodies a robot is, what its actuators drive, what is not supported."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.sim.mujoco.mocap import pulls

__all__ = [
    "WARNINGS",
    "Hanging",
    "ancestors",
    "check_supported",
    "driven_roots",
    "hanging",
    "joint_type",
    "label",
    "moves",
    "outermost",
    "scalar_joints",
    "tendon_bodies",
    "warned",
]

WARNINGS = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC", "mjWARN_BADCTRL")
"""MuJoCo's warnings after which a step means nothing."""

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


def scalar_joints(model: Any, joints: np.ndarray, drivers: Mapping[int, str]) -> np.ndarray:
    """Numbers (J,) of the robot's joints, all of one degree of freedom.

    Args:
        model: MuJoCo's.
        joints: numbers (J,).
        drivers: outermost body -> what drives it.

    Raises:
        PwmGymError: one of them is free or a ball.
    """
    for joint in joints.tolist():
        if model.jnt_type[joint] not in (joint_type("SLIDE"), joint_type("HINGE")):
            body = int(model.jnt_bodyid[joint])
            told = next((drivers[k] for k in ancestors(model, body) if k in drivers), "a mocap body")
            raise PwmGymError(
                f"the robot's joint {label(model.joint(joint))} of body {label(model.body(body))} is free or a ball, "
                f"driven by {told}; expected slides and hinges in what actuators drive"
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


def outermost(model: Any, body: int) -> int | None:
    """The outermost moving body of the tree that a body is in; None where it is fixed to the world."""
    moving = [k for k in ancestors(model, body) if model.body_jntnum[k]]
    return moving[-1] if moving else None


def driven_roots(model: Any) -> dict[int, str]:
    """Outermost moving bodies of the trees that an actuator or a mocap body drives, and what drives them, in words.

    Raises:
        PwmGymError: an actuator drives a slider-crank.
    """
    driven = []
    for k in range(model.nu):
        means, bodies = _transmission(model, k)
        driven += [(body, f"actuator {label(model.actuator(k))} through {means}") for body in bodies]
    driven += [(pull.body, f"mocap body {label(model.body(pull.mocap))}") for pull in pulls(model)]
    roots: dict[int, str] = {}
    for body, told in driven:
        root = outermost(model, body)
        if root is not None:
            roots.setdefault(root, told)
    return roots


def _transmission(model: Any, actuator: int) -> tuple[str, list[int]]:
    """Through what an actuator drives, in words, and the bodies that it drives.

    Raises:
        PwmGymError: it drives a slider-crank.
    """
    import mujoco

    kinds, target = mujoco.mjtTrn, int(model.actuator_trnid[actuator, 0])
    kind = int(model.actuator_trntype[actuator])
    if kind in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
        return f"joint {label(model.joint(target))}", [int(model.jnt_bodyid[target])]
    if kind == int(kinds.mjTRN_TENDON):
        return f"tendon {label(model.tendon(target))}", tendon_bodies(model, target)
    if kind == int(kinds.mjTRN_BODY):
        return f"adhesion of body {label(model.body(target))}", [target]
    if kind == int(kinds.mjTRN_SITE):
        return f"site {label(model.site(target))}", [int(model.site_bodyid[target])]
    raise PwmGymError(
        f"actuator {label(model.actuator(actuator))} drives a slider-crank by site {label(model.site(target))}; "
        "expected one that drives a joint, a tendon, a site or a body"
    )


def tendon_bodies(model: Any, tendon: int) -> list[int]:
    """Bodies that a tendon pulls, by joints or by sites."""
    import mujoco

    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    found = []
    for k in range(first, first + count):
        if model.wrap_type[k] == int(mujoco.mjtWrap.mjWRAP_JOINT):
            found.append(int(model.jnt_bodyid[model.wrap_objid[k]]))
        elif model.wrap_type[k] == int(mujoco.mjtWrap.mjWRAP_SITE):
            found.append(int(model.site_bodyid[model.wrap_objid[k]]))
    return found


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
    _check_memory(model)


def _check_memory(model: Any) -> None:
    """Refuse actuators whose force depends on more than positions, velocities and controls: no scene tells it."""
    for k in range(model.nu):
        name = label(model.actuator(k))
        if model.actuator_actnum[k]:
            raise PwmGymError(
                f"actuator {name} has an activation, which a scene does not tell; expected one whose dyntype is none, "
                "such as a position without timeconst, a velocity or a motor"
            )
        if getattr(model, "nhistory", 0) and model.actuator_history[k, 0]:  # older MuJoCo has none
            raise PwmGymError(
                f"actuator {name} remembers past controls, which a scene does not tell; expected one without a delay"
            )


def warned(model: Any, warning: str, number: int) -> str:
    """What one of :data:`WARNINGS` means.

    Args:
        model: MuJoCo's.
        warning: its name.
        number: of a control, of a component of the positions, or of a degree of freedom.
    """
    if warning == "mjWARN_BADCTRL":
        return f"the control of actuator {label(model.actuator(number))} is no finite number"
    if warning == "mjWARN_BADQPOS":
        joint = int(np.searchsorted(model.jnt_qposadr, number, side="right")) - 1
        body = int(model.jnt_bodyid[joint])
    else:
        body = int(model.dof_bodyid[number])
    return f"the simulation diverged: body {label(model.body(body))} moves beyond all bounds or is not a number"
