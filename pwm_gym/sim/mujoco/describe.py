"""What a MuJoCo model tells of its robot and of its scene, so that nobody has to write it down."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Channel, Control, Robot
from pwm_gym.scene import Layout, Support
from pwm_gym.scene.joint import FIXED, FREE, Joint, JointKind, Mimic, Pose7
from pwm_gym.scene.poses import relative, rotation
from pwm_gym.sim.mujoco.adapter import MujocoSimulator
from pwm_gym.sim.mujoco.couplings import check_couplings
from pwm_gym.sim.mujoco.meshes import collides
from pwm_gym.sim.mujoco.structure import Hanging, hanging, joint_type, label, moves
from pwm_gym.sim.mujoco.worlds import XmlWorld

__all__ = ["layout_of", "robot_of"]

_UNLIMITED = 10.0  # metres, or radians: more than any position that a pose tells
_EDGELESS = 100.0  # metres: half the width of a plane


def robot_of(simulator: MujocoSimulator, name: str, channels: Sequence[Channel] | None = None) -> Robot:
    """The robot of a simulator's model.

    A link that hangs on one joint of its own moves along that joint; one that hangs on several (its arm's links are no
    entities) is a hand, which moves as a whole. How they respond to actions is fitted to data.

    Args:
        simulator: whose entities are the robot's links first, then all others.
        name: of the robot.
        channels: what an action's components mean. By default each drives an actuator: position-controlled ones take
            targets, all others a command whose zero asks for nothing.

    Raises:
        PwmGymError: the robot has no link among the entities, links that do not come first, or actions of its own
            meaning without ``channels``.
    """
    names = simulator.assets()
    links = {entity: body for entity, body in simulator.bodies.items() if entity in simulator.links}
    if not links or tuple(links) != names[: len(links)]:
        told = ", ".join(links) or "none"
        raise PwmGymError(f"entities {', '.join(names)}, of which the robot drives {told}; expected those first")
    return Robot(
        name=name,
        links=links,
        control=Control(
            tuple(_actuators(simulator) if channels is None else channels), period=float(simulator.world.period)
        ),
        joints={entity: joint for entity, joint in _joints(simulator, links).items() if joint.kind != "free"},
    )


def layout_of(simulator: MujocoSimulator, points: int = 300) -> Layout:
    """The entities of a simulator's model, how they hang on each other, and what they may lie on.

    Planes and boxes that are fixed to the world and belong to no entity are supports, where they can be touched. Of the
    robot, links that can be touched may be left out: its joints place them.

    Args:
        simulator: of the model.
        points: of each entity.

    Raises:
        PwmGymError: an entity that hangs on several joints, which are not those of a free body, or something that can
            be touched, belongs to no entity and is neither a plane or a box of the world nor part of the robot, or
            something that couples entities without a touch and is no linear equality of joints.
    """
    names = simulator.assets()
    check_couplings(simulator.model, simulator.robot_bodies)
    return Layout.build(
        [(name, points) for name in names],
        driven=[name for name in names if name in simulator.links],
        joints=_joints(simulator, names),
        supports=[*_supports(simulator)],
    )


def _actuators(simulator: MujocoSimulator) -> list[Channel]:
    """One channel for each run of actuators that are alike."""
    model, world = simulator.model, simulator.world
    if isinstance(world, XmlWorld) and not world.direct:
        raise PwmGymError("the world gives actions a meaning of its own (`act`); expected `channels` that tell it")
    if model.nu != world.action_size:
        raise PwmGymError(
            f"the world takes actions of {world.action_size} components and has {model.nu} actuators; expected "
            "`channels` that tell what they mean"
        )
    rests = [_rest(model, k) for k in range(model.nu)]
    channels, start = [], 0
    for rest, run in groupby(rests):
        stop = start + len([*run])
        channels.append(Channel("joint", start, stop, rest=rest))
        start = stop
    return channels


def _rest(model: Any, actuator: int) -> float | None:
    """Action that asks an actuator for nothing; None of one that drives to a position."""
    if model.actuator_biasprm[actuator, 1]:  # its force depends on where it is
        return None
    low, high = model.actuator_ctrlrange[actuator]
    return float(np.clip((low + high) / (low - high), -1.0, 1.0)) + 0.0 if high > low else 0.0  # no negative zero


def _joints(simulator: MujocoSimulator, names: Iterable[str]) -> dict[str, Joint]:
    """Joint of each of the entities ``names``."""
    bodies = {name: simulator.body_id(name) for name in simulator.assets()}
    ids = set(bodies.values())
    entities = {body: name for name, body in bodies.items()}
    places = {name: hanging(simulator.model, bodies[name], ids) for name in names}
    moving = {name: place.joints[0] for name, place in places.items() if len(place.joints) == 1}
    found = {name: _joint(simulator, name, place, entities) for name, place in places.items()}
    return {name: _following(simulator.model, joint, moving, name) for name, joint in found.items()}


def _joint(simulator: MujocoSimulator, name: str, place: Hanging, entities: dict[int, str]) -> Joint:
    model = simulator.model
    kinds = [int(model.jnt_type[k]) for k in place.joints]
    parent = None if place.parent is None else entities[place.parent]
    if not kinds and parent is None:
        return FREE if moves(model, simulator.body_id(name)) else FIXED  # a mocap body goes anywhere
    if not kinds:
        origin, _ = _origin(simulator, name, parent, None)
        return Joint("fixed", parent, origin)
    if len(kinds) > 1 and (name in simulator.links or _is_loose(kinds)):
        return FREE  # a hand, or what six joints in a row let move as a free body
    if kinds == [joint_type("FREE")]:
        return FREE
    if len(kinds) > 1 or kinds == [joint_type("BALL")]:
        told = ", ".join(model.joint(k).name or f"number {k}" for k in place.joints)
        raise PwmGymError(f"entity {name!r} hangs on joints {told}; expected one slide or hinge, or a free joint")
    origin, axis = _origin(simulator, name, parent, place.joints[0])
    low, high = model.jnt_range[place.joints[0]] if model.jnt_limited[place.joints[0]] else (-_UNLIMITED, _UNLIMITED)
    kind: JointKind = "revolute" if kinds == [joint_type("HINGE")] else "prismatic"
    return Joint(kind, parent, origin, axis, float(low), float(high))


def _is_loose(kinds: list[int]) -> bool:
    """Whether joints of these kinds let a body go anywhere and turn about anything."""
    turns = kinds.count(joint_type("HINGE")) >= 3 or joint_type("BALL") in kinds
    return turns and kinds.count(joint_type("SLIDE")) >= 3


def _origin(
    simulator: MujocoSimulator, name: str, parent: str | None, joint: int | None
) -> tuple[Pose7, tuple[float, float, float]]:
    """Pose of an entity in its parent's frame where its ``joint`` is at 0, and that joint's axis in its own frame."""
    import mujoco

    model = simulator.model
    data = mujoco.MjData(model)
    if joint is not None:
        data.qpos[model.jnt_qposadr[joint]] = 0.0
    mujoco.mj_kinematics(model, data)
    poses = simulator.poses(data)
    names = simulator.assets()
    pose = poses[names.index(name)]
    if parent is not None:
        pose = relative(poses[names.index(parent)], pose[None])[0]
    axis = np.array([0.0, 0.0, 1.0])
    if joint is not None:
        axis = data.xmat[simulator.body_id(name)].reshape(3, 3).T @ data.xaxis[joint]
    x, y, z, *turn = pose.tolist()
    return (x, y, z, *turn), tuple((axis / np.linalg.norm(axis)).tolist())


def _following(model: Any, joint: Joint, moving: dict[str, int], name: str) -> Joint:
    """The joint with the one that it follows by a linear equality constraint, if that moves an entity, too."""
    import mujoco

    names = {number: entity for entity, number in moving.items()}
    for k in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
        first, second = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        linear = not model.eq_data[k, 2:5].any()
        if moving.get(name) != first or second not in names or not (linear and model.eq_active0[k]):
            continue
        start, slope = model.eq_data[k, :2].tolist()
        starts = model.qpos0[model.jnt_qposadr[[first, second]]]
        mimic = Mimic(names[second], slope, float(starts[0] + start - slope * starts[1]))
        return replace(joint, mimic=mimic)
    return joint


def _supports(simulator: MujocoSimulator) -> Iterable[Support]:
    """Planes and boxes of the world that can be touched."""
    import mujoco

    model, data = simulator.model, simulator.data
    owned = simulator.geoms()
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if geom in owned or body in simulator.robot_bodies or not collides(model, geom):
            continue
        if moves(model, body):
            raise PwmGymError(_no_entity(model, geom))
        kind = int(model.geom_type[geom])
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, data.geom_xmat[geom])
        pose = np.r_[data.geom_xpos[geom], turn]
        half = model.geom_size[geom].copy()
        if kind == int(mujoco.mjtGeom.mjGEOM_PLANE):
            half = np.array([_EDGELESS, _EDGELESS, 1.0])
            pose[:3] -= rotation(pose).apply([0.0, 0.0, 1.0])
        elif kind != int(mujoco.mjtGeom.mjGEOM_BOX):
            raise PwmGymError(_no_support(model, geom))
        x, y, z, *rest = relative(simulator.base, pose[None])[0].round(12).tolist()
        yield Support((x, y, z, *rest), tuple(half.tolist()))


def _no_entity(model: Any, geom: int) -> str:
    body = label(model.body(int(model.geom_bodyid[geom])))
    return (
        f"geom {label(model.geom(geom))} of body {body} can be touched and moves, and is part neither of an entity nor "
        "of the robot; expected its body among the entities"
    )


def _no_support(model: Any, geom: int) -> str:
    import mujoco

    name = label(model.geom(geom))
    body = label(model.body(int(model.geom_bodyid[geom])))
    if model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_HFIELD):
        return f"geom {name} of body {body} is a height field, which is not supported; expected planes and boxes"
    return (
        f"geom {name} of body {body} can be touched and is neither a plane nor a box; expected its body among the "
        "entities"
    )
