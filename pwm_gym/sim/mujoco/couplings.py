"""Tendons and equalities by which bodies move each other without a touch."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.sim.mujoco.structure import label, moves, tendon_bodies

__all__ = ["check_couplings"]

_ACTS = ("tendon_stiffness", "tendon_damping", "tendon_frictionloss", "tendon_armature", "tendon_limited")


def check_couplings(model: Any, robot: frozenset[int]) -> None:
    """Refuse what couples bodies though they do not touch.

    World models take an object that nothing touches to be at rest. Linear equalities of joints are followed, and what
    couples the robot's bodies alone is fitted with it.

    Args:
        model: MuJoCo's.
        robot: bodies that are the robot.

    Raises:
        PwmGymError: a tendon, a tendon equality or a joint equality that is not linear couples others.
    """
    import mujoco

    for k in range(model.ntendon):
        if any(np.any(getattr(model, name)[k]) for name in _ACTS):
            _check(model, robot, tendon_bodies(model, k), f"tendon {label(model.tendon(k))}")
    for k in np.flatnonzero(model.eq_active0).tolist():
        elements = [int(e) for e in (model.eq_obj1id[k], model.eq_obj2id[k]) if e >= 0]
        name = label(model.equality(k))
        if model.eq_type[k] == int(mujoco.mjtEq.mjEQ_TENDON):
            _check(model, robot, [b for e in elements for b in tendon_bodies(model, e)], f"tendon equality {name}")
        elif model.eq_type[k] == int(mujoco.mjtEq.mjEQ_JOINT) and model.eq_data[k, 2:5].any():
            bodies = [int(model.jnt_bodyid[e]) for e in elements]
            _check(model, robot, bodies, f"joint equality {name}, which is not linear,")


def _check(model: Any, robot: frozenset[int], bodies: Iterable[int], element: str) -> None:
    """Refuse an element that couples moving bodies of which some are not the robot's."""
    moving = {int(model.body_weldid[b]) or b: b for b in bodies if moves(model, b)}
    if len(moving) > 1 and not robot >= {*moving.values()}:
        told = " and ".join(label(model.body(b)) for b in moving.values())
        raise PwmGymError(
            f"{element} couples bodies {told}, which world models take to be at rest where nothing touches them; "
            "expected contacts, a joint between them or a linear equality of their joints"
        )
