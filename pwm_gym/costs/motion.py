"""How fast clouds move. Velocities of clouds are metres a control step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from pwm_gym.costs.contacts import Points, centre
from pwm_gym.robots.speeds import JointSpeeds

__all__ = ["angular_velocity", "hinge_speeds", "joint_speed", "speed", "spin"]


def speed(velocity: Points, name: str) -> Tensor:
    """Speed (B,) of an entity's centre, metres a step."""
    return velocity[name].mean(-2).norm(dim=-1)


def spin(points: Points, velocity: Points, name: str) -> Tensor:
    """Turn (B,) of an entity about the vertical axis, radians a step: least squares over its points."""
    offset = (points[name] - points[name].mean(-2, keepdim=True))[..., :2]
    moved = (velocity[name] - velocity[name].mean(-2, keepdim=True))[..., :2]
    torque = (offset[..., 0] * moved[..., 1] - offset[..., 1] * moved[..., 0]).sum(-1)
    return torque / offset.square().sum((-1, -2)).clamp_min(1e-9)


def angular_velocity(points: Points, velocity: Points, name: str) -> Tensor:
    """Turn (B, 3) of an entity, radians a step: least squares over its points."""
    offset = points[name] - points[name].mean(-2, keepdim=True)
    moved = velocity[name] - velocity[name].mean(-2, keepdim=True)
    momentum = torch.cross(offset, moved, dim=-1).sum(-2)
    square = offset.transpose(-1, -2) @ offset
    eye = torch.eye(3, dtype=square.dtype, device=square.device)
    trace = square.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    inertia = trace * eye - square
    return torch.linalg.solve(inertia + 1e-9 * eye, momentum)


def hinge_speeds(points: Points, velocity: Points, parents: Mapping[str, str | None]) -> Tensor:
    """Sum (B,) of the squared speeds of hinges, radians a step: each is the turn of an entity against its parent's.

    Args:
        points: clouds.
        velocity: metres a step.
        parents: entity -> its parent; None is the world.
    """
    turns = {name: angular_velocity(points, velocity, name) for name in {*parents, *filter(None, parents.values())}}
    against = [turns[name] - turns[parent] if parent else turns[name] for name, parent in parents.items()]
    return torch.stack(against).square().sum((0, -1))


def joint_speed(points: Points, info: Mapping[str, Any], arm: JointSpeeds, order: float = torch.inf) -> Tensor:
    """Speed (B,) in rad/s of the arm's joints; where joints are not known, as the hand's motion tells it.

    Args:
        points: clouds.
        info: what costs read.
        arm: what tells joint speeds from the hand's motion.
        order: of the norm over the joints: infinite for the fastest one.
    """
    rate = 1.0 / arm.period
    joints = info.get("joints")
    if joints is not None:
        return rate * torch.linalg.vector_norm(joints[..., 1, : arm.joints], ord=order, dim=-1)
    position = centre(points, "hand")
    velocity = rate * centre(info["velocity"], "hand")
    radius = position[..., :2].norm(dim=-1).clamp_min(1e-3)
    outward = position[..., :2] / radius.unsqueeze(-1)
    radial = (velocity[..., :2] * outward).sum(-1)
    sideways = velocity[..., 1] * outward[..., 0] - velocity[..., 0] * outward[..., 1]
    bending = torch.stack([radial, velocity[..., 2]], -1) @ velocity.new_tensor(arm.bending).T
    base = sideways / radius
    wrist = rate * spin(points, info["velocity"], "hand") - base
    turns = torch.cat([bending, base.unsqueeze(-1), wrist.unsqueeze(-1)], -1)
    return arm.averaged * torch.linalg.vector_norm(turns, ord=order, dim=-1)
