"""The robot's bodies and joints in a MuJoCo model, and how everything else moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.sim.mujoco.mocap import Pull, pulls
from pwm_gym.sim.mujoco.structure import ancestors, driven_roots, joint_type, label, outermost, scalar_joints

__all__ = ["Parts", "sort_parts"]


@dataclass(frozen=True)
class Parts:
    """A model's parts by what moves them; bodies, joints and degrees of freedom are MuJoCo's numbers."""

    robot: frozenset[int]
    """Bodies that are the robot, whether or not they are entities."""
    links: frozenset[str]
    """Entities among them."""
    joints: np.ndarray
    """The robot's slides and hinges (J,)."""
    free: Mapping[str, int]
    """Entity -> its free joint."""
    mocaps: Mapping[str, int]
    """Entity that is a mocap body -> its number among these."""
    articulated: Mapping[str, int]
    """Entity on other joints -> its body."""
    dofs: np.ndarray
    """Degrees of freedom (D,) that are neither the robot's nor a free body's."""


def sort_parts(model: Any, entities: Mapping[str, int], root: int | None = None) -> Parts:
    """Sort a model's bodies and joints: the robot's, free ones, and all others.

    Args:
        model: MuJoCo's.
        entities: name -> body.
        root: outermost body of the robot, where it is not what actuators and mocap bodies drive.

    Raises:
        PwmGymError: the robot hangs on a ball or a free joint that no mocap body moves, or an entity hangs on a mocap
            body that is none.
    """
    _check_carried(model, entities)
    drivers = driven_roots(model) if root is None else {root: "`robot`"}
    mocaps = {name: int(model.body_mocapid[k]) for name, k in entities.items() if model.body_mocapid[k] >= 0}
    roots = {*drivers, *(pull.mocap for pull in pulls(model) if {*ancestors(model, pull.body)} & {*drivers})}
    if root is None:
        roots |= {entities[name] for name in mocaps}
    robot = frozenset(k for k in range(model.nbody) if roots & {*ancestors(model, k)})
    mine = np.array([k in robot for k in model.jnt_bodyid], bool)
    free = model.jnt_type == joint_type("FREE")
    floating = free & mine & np.isin(np.arange(model.njnt), _floating(model, entities))
    owner = {int(model.jnt_bodyid[k]): int(k) for k in np.flatnonzero(floating | (free & ~mine))}
    loose = {name: owner[k] for name, k in entities.items() if k in owner}
    others = np.flatnonzero(~mine & ~free)
    moved = {int(model.jnt_bodyid[k]) for k in others}
    return Parts(
        robot=robot,
        links=frozenset(name for name, k in entities.items() if k in robot),
        joints=scalar_joints(model, np.flatnonzero(mine & ~floating), drivers),
        free=loose,
        mocaps=mocaps,
        articulated={name: k for name, k in entities.items() if moved & {*ancestors(model, k)} and name not in loose},
        dofs=np.flatnonzero(np.isin(model.dof_jntid, others)),
    )


def _check_carried(model: Any, entities: Mapping[str, int]) -> None:
    """Refuse entities whose place a mocap body decides that a scene does not tell of."""
    for name, body in entities.items():
        outer = int(model.body_rootid[body])
        if model.body_mocapid[outer] >= 0 and outer not in entities.values():
            told = label(model.body(outer))
            raise PwmGymError(f"entity {name!r} hangs on mocap body {told}, which is none; expected {told} to be one")


def _floating(model: Any, entities: Mapping[str, int]) -> list[int]:
    """Free joints of bodies that mocap bodies pull; a scene's poses place them."""
    found = []
    for pull in pulls(model):
        body = outermost(model, pull.body)
        if body is None or model.jnt_type[model.body_jntadr[body]] != joint_type("FREE"):
            continue
        if body not in entities.values():
            raise PwmGymError(_unplaced(model, body, pull))
        found.append(int(model.body_jntadr[body]))
    return found


def _unplaced(model: Any, body: int, pull: Pull) -> str:
    kind = "weld" if pull.turns else "connect"
    constraint = f"{kind} {label(model.equality(pull.constraint))}"
    return (
        f"body {label(model.body(body))} has a free joint, and {constraint} binds it "
        f"to mocap body {label(model.body(pull.mocap))}; expected it among the entities, whose poses place it"
    )
