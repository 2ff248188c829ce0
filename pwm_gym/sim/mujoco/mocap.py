"""Mocap bodies: what they pull by welds and connections, and where they stand when these are satisfied."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

__all__ = ["Pull", "place_mocaps", "pulls"]

_UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Pull:
    """A weld or a connection by which a mocap body pulls another one."""

    constraint: int
    """MuJoCo's number of it among the equality constraints."""
    mocap: int
    """The mocap body."""
    body: int
    """The body that is pulled."""
    turns: bool
    """Whether it is a weld, which holds the orientation, too."""
    own: np.ndarray
    """Pose (7,) in the mocap body's frame of what is held together."""
    other: np.ndarray
    """Pose (7,) of the same in the pulled body's frame."""


def pulls(model: Any) -> Iterator[Pull]:
    """The active welds and connections of a mocap body with one that is none, by bodies or by sites."""
    import mujoco

    weld, connect = int(mujoco.mjtEq.mjEQ_WELD), int(mujoco.mjtEq.mjEQ_CONNECT)
    for k in np.flatnonzero(np.isin(model.eq_type, (weld, connect)) & (model.eq_active0 != 0)).tolist():
        turns = bool(model.eq_type[k] == weld)
        sides = _sides(model, k, turns)
        for (mocap, own), (body, other) in (sides, sides[::-1]):
            if model.body_mocapid[mocap] >= 0 and model.body_mocapid[body] < 0:
                yield Pull(k, mocap, body, turns, own, other)


def _sides(model: Any, constraint: int, weld: bool) -> list[tuple[int, np.ndarray]]:
    """Both bodies of a constraint, each with the pose (7,) in its frame of what is held together."""
    import mujoco

    elements = int(model.eq_obj1id[constraint]), int(model.eq_obj2id[constraint])
    if model.eq_objtype[constraint] == int(mujoco.mjtObj.mjOBJ_SITE):
        return [(int(model.site_bodyid[k]), np.r_[model.site_pos[k], model.site_quat[k]]) for k in elements]
    constants = model.eq_data[constraint]
    if weld:  # whose anchor is told in the second body, before the place in the first one
        poses = np.r_[constants[3:6], constants[6:10]], np.r_[constants[:3], _UNTURNED]
    else:
        poses = np.r_[constants[:3], _UNTURNED], np.r_[constants[3:6], _UNTURNED]
    return [*zip(elements, poses, strict=True)]


def place_mocaps(model: Any, data: Any, told: Collection[int] = ()) -> None:
    """Put each mocap body that pulls another one where the constraint is satisfied.

    A connection leaves its orientation as it is.

    Args:
        model: MuJoCo's.
        data: MuJoCo's.
        told: numbers of mocap bodies that are where they shall be.
    """
    import mujoco

    mujoco.mj_kinematics(model, data)
    for pull in pulls(model):
        number = int(model.body_mocapid[pull.mocap])
        if number in told:
            continue
        pulled = Rotation.from_quat(data.xquat[pull.body], scalar_first=True)
        held = pulled * Rotation.from_quat(pull.other[3:], scalar_first=True)
        turn = Rotation.from_quat(data.mocap_quat[number], scalar_first=True)
        if pull.turns:
            turn = held * Rotation.from_quat(pull.own[3:], scalar_first=True).inv()
            data.mocap_quat[number] = turn.as_quat(scalar_first=True)
        data.mocap_pos[number] = data.xpos[pull.body] + pulled.apply(pull.other[:3]) - turn.apply(pull.own[:3])
