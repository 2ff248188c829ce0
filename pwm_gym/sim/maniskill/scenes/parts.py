"""Furniture and things of our own ManiSkill tasks: how each is built, and how its episode starts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.utils.structs import Actor, Pose

from pwm_gym.scene.joint import Joint
from pwm_gym.sim.cabinets import LOW_CABINET, Cabinet
from pwm_gym.sim.coffee_machine import LID, LID_JOINT, MACHINE, POD, POD_HEIGHT
from pwm_gym.sim.maniskill.build import add_shapes
from pwm_gym.sim.maniskill.scenes.common import about_z
from pwm_gym.sim.mugs import MUGS

__all__ = [
    "build_cabinet",
    "build_machine",
    "build_mugs",
    "build_pod",
    "near_places",
    "put_articulation",
    "random_places",
]

_DRAWER_FRICTION, _DRAWER_DAMPING = 1.0, 20.0  # it stays where it is left
_POD_FRICTION, _MACHINE_FRICTION, _LID_DAMPING = 0.5, 0.3, 0.004
_WOOD, _RED = (0.55, 0.40, 0.26, 1.0), (0.75, 0.15, 0.12, 1.0)
_GREY, _WHITE, _BROWN = (0.3, 0.3, 0.32, 1.0), (0.85, 0.85, 0.85, 1.0), (0.35, 0.2, 0.1, 1.0)


def build_cabinet(scene: Any, place: tuple[float, float], model: Cabinet = LOW_CABINET) -> Any:
    """Articulation ``cabinet`` with its ``drawer``, which faces the robot at a place in the plane.

    Args:
        scene: to build it in.
        place: of its middle.
        model: its boxes and its joint.
    """
    builder = scene.create_articulation_builder()
    body = builder.create_link_builder()
    body.set_name("cabinet")
    add_shapes(body, model.body, _WOOD)
    drawer = builder.create_link_builder(body)
    drawer.set_name("drawer")
    drawer.set_joint_name("slide")
    origin = sapien.Pose(model.joint.origin[:3])  # SAPIEN's joints slide along x, as this one does
    drawer.set_joint_properties("prismatic", _limits(model.joint), origin, sapien.Pose(), damping=_DRAWER_DAMPING)
    add_shapes(drawer, model.drawer, _WOOD, density=400.0)
    builder.initial_pose = sapien.Pose([*place, model.half[2]], [0.0, 0.0, 0.0, 1.0])
    built = builder.build(name="cabinet", fix_root_link=True)
    built.active_joints[0].set_friction(_DRAWER_FRICTION)
    return built


def build_machine(scene: Any, place: tuple[float, float]) -> Any:
    """Articulation ``machine`` with its ``lid``, which faces the robot, its holder at a place in the plane."""
    smooth = sapien.physx.PhysxMaterial(_MACHINE_FRICTION, _MACHINE_FRICTION, 0.0)
    builder = scene.create_articulation_builder()
    machine = builder.create_link_builder()
    machine.set_name("machine")
    add_shapes(machine, MACHINE, _GREY, material=smooth)
    lid = builder.create_link_builder(machine)
    lid.set_name("lid")
    lid.set_joint_name("hinge")
    to_axis = [0.5**0.5, 0.0, 0.0, -(0.5**0.5)]  # SAPIEN's joints turn about x: here the lid's -y
    origin, own = sapien.Pose(LID_JOINT.origin[:3], to_axis), sapien.Pose(q=to_axis)
    lid.set_joint_properties("revolute", _limits(LID_JOINT), origin, own, damping=_LID_DAMPING)
    add_shapes(lid, LID, _WHITE, density=400.0, material=smooth)
    builder.initial_pose = sapien.Pose([*place, 0.0], [0.0, 0.0, 0.0, 1.0])
    built = builder.build(name="machine", fix_root_link=True)
    built.active_joints[0].set_friction(0.0)
    return built


def build_pod(scene: Any, place: tuple[float, float]) -> Any:
    """Actor ``pod``."""
    builder = scene.create_actor_builder()
    rubbing = sapien.physx.PhysxMaterial(_POD_FRICTION, _POD_FRICTION, 0.0)
    add_shapes(builder, POD, _BROWN, density=500.0, material=rubbing)
    builder.initial_pose = sapien.Pose([*place, 0.5 * POD_HEIGHT])
    return builder.build(name="pod")


def build_mugs(env: Any, names: Sequence[str], place: tuple[float, float]) -> Any:
    """Actor ``mug`` of a task, one of ``names`` in each of its environments."""
    mugs = []
    for i, name in enumerate(names):
        builder = env.scene.create_actor_builder()
        add_shapes(builder, MUGS[name].shapes(), _RED, density=600.0)
        builder.initial_pose = sapien.Pose([*place, 0.5 * MUGS[name].height])
        builder.set_scene_idxs([i])
        mugs.append(builder.build(name=f"{name}-{i}"))
        env.remove_from_state_dict_registry(mugs[-1])
    mug = Actor.merge(mugs, name="mug")
    env.add_to_state_dict_registry(mug)
    return mug


def put_articulation(
    articulation: Any,
    place: tuple[float, float, float],
    spread: tuple[float, float, float],
    position: float,
    count: int,
) -> None:
    """Put ``count`` articulations facing the robot near a place, their one joint at a position, at rest.

    Args:
        articulation: of a cabinet or a machine.
        place: of its root (3,).
        spread: x, y and yaw, to either side.
        position: of the joint.
        count: environments.
    """
    offset = (2 * torch.rand((count, 3)) - 1) * torch.tensor(spread)
    places = torch.tensor(place).repeat(count, 1)
    places[:, :2] += offset[:, :2]
    articulation.set_pose(Pose.create_from_pq(places, about_z(np.pi + offset[:, 2])))
    articulation.set_qpos(torch.full((count, 1), position))
    articulation.set_qvel(torch.zeros((count, 1)))


def random_places(low: tuple[float, float], high: tuple[float, float], heights: torch.Tensor) -> Any:
    """Poses in any yaw, anywhere between two corners in the plane, at given heights (B,)."""
    count, corner = len(heights), torch.tensor(low)
    flat = corner + torch.rand((count, 2)) * (torch.tensor(high) - corner)
    places = torch.cat([flat, heights.unsqueeze(-1)], -1)
    return Pose.create_from_pq(places, about_z(2 * np.pi * torch.rand(count)))


def near_places(place: tuple[float, float, float], spread: tuple[float, float, float], count: int) -> Any:
    """Poses near a place (3,), by ``spread`` (x, y and yaw) to either side."""
    offset = (2 * torch.rand((count, 3)) - 1) * torch.tensor(spread)
    places = torch.tensor(place).repeat(count, 1)
    places[:, :2] += offset[:, :2]
    return Pose.create_from_pq(places, about_z(offset[:, 2]))


def _limits(joint: Joint) -> list[list[float]]:
    return [[joint.lower, joint.upper]]
