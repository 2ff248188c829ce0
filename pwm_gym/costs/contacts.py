"""What the clouds of a parallel gripper and an object tell of their contact. Metres, in the robot base's frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from math import radians
from typing import Concatenate, ParamSpec, TypeVar

import torch
from torch import Tensor

from pwm_gym.robots.gripper import PANDA, Gripper

__all__ = [
    "MOST_SUNK",
    "PAD_END",
    "PAD_HALF_WIDTH",
    "across",
    "along",
    "centre",
    "closing",
    "crushed",
    "finger_gaps",
    "fingers_apart",
    "fingers_axis",
    "firmness",
    "forward",
    "level",
    "middle",
    "near_and_shut",
    "once",
    "opening",
    "outside_fingers",
    "pad_gaps",
    "pinched",
    "squared",
    "stopped",
    "tool_centre",
    "tool_distance",
    "width_between",
]

Points = Mapping[str, Tensor]
P = ParamSpec("P")
T = TypeVar("T")

PAD_HALF_WIDTH, PAD_END = PANDA.pad_reach, PANDA.pad_end
"""Metres that the Panda's pads reach to either side of the tool centre, and beyond it."""

MOST_SUNK = 0.015
"""Metres by which both pads together may sink into what is between them."""

_MOST_TURN, _TURNS = radians(16.0), 17  # around a direction that is known roughly
_SIDE_POINTS = 640  # that tell it: to 0.02 degrees of a cabinet, where 2,560 tell it to 0.006
_SAME_WAY = 0.995  # cosine of 6 degrees: rough directions between which a box's own does not change
_CLOSE = 0.025  # the paper's grasp distance
# Metres. ManiSkill's pads sink 0.3 mm (half shut) to 2.8 mm into an object that they hold, and 8 mm into the width of a
# corner; a model may see it 2 mm nearer to one pad.
_DEEPEST, _LOOSEST = -0.008, 0.001
_HELD = 0.036  # how far from an object's centre its corner can be held
_SPARSE, _STOPPED = 0.005, 0.0005  # metres, and metres a step: of a grasp on an object whose points lie far apart
_HALF_SHUT = 0.2  # a gripper commanded below this shuts on an object of 4 cm
_SUNK = 0.010  # metres by which a pad may overlap the object's extent and still count as pressing on it
_BETWEEN = 0.013  # metres from tool to centre within which the object is between the finger tips


def once(term: Callable[Concatenate[Points, P], T]) -> Callable[Concatenate[Points, P], T]:
    """Decorator: points that keep a memo (an environment's and a planner's do) form a quantity once.

    All terms then share what was formed, which none may change in place.
    """

    @wraps(term)
    def formed(points: Points, /, *args: P.args, **kwargs: P.kwargs) -> T:
        memo = getattr(points, "memo", None)
        if memo is None:
            return term(points, *args, **kwargs)
        key = (term, args, tuple(kwargs.items()))
        if key not in memo:
            memo[key] = term(points, *args, **kwargs)
        found: T = memo[key]
        return found

    return formed


@once
def centre(points: Points, name: str) -> Tensor:
    """Mean (B, 3) of an entity's points."""
    return points[name].mean(-2)


@once
def middle(points: Points, name: str) -> Tensor:
    """Middle (B, 3) of an entity's extents along the axes: nearer to the origin of most meshes than their centre."""
    return 0.5 * (points[name].amin(-2) + points[name].amax(-2))


@once
def tool_centre(points: Points, gripper: Gripper = PANDA) -> Tensor:
    """Point (B, 3) between the finger tips: on the line from the hand's centre through the fingers' centre."""
    fingers = 0.5 * (centre(points, "left_gripper") + centre(points, "right_gripper"))
    hand = centre(points, "hand")
    if gripper.tool_reach is None:
        return fingers + gripper.tool_ratio * (fingers - hand)
    way = fingers - hand
    return hand + gripper.tool_reach * way / way.norm(dim=-1, keepdim=True).clamp_min(1e-6)


@once
def finger_gaps(points: Points, name: str) -> Tensor:
    """Gaps (B, 2) between each finger's inner side and the object's, along the fingers' axis.

    Zero: touching. Slightly negative: pressing. More: the finger is past that side, beside or above the object.
    """
    axis = fingers_axis(points)
    places = along(points[name], axis)
    return _gaps(points, axis, places.amin(-1), places.amax(-1))


@once
def pad_gaps(points: Points, name: str, gripper: Gripper = PANDA) -> Tensor:
    """Gaps (B, 2) as :func:`finger_gaps`, to that part of the object which is between the fingers' pads.

    Huge where no part is. What of a bowl, say, lies beyond a finger is not between them.
    """
    axis, places = fingers_axis(points), along(points[name], fingers_axis(points))
    left, right = (along(centre(points, f).unsqueeze(-2), axis) for f in ("left_gripper", "right_gripper"))
    offset = points[name] - tool_centre(points, gripper).unsqueeze(-2)
    ahead = along(offset, forward(points)) <= gripper.pad_end
    beside = along(offset, torch.cross(axis, forward(points), dim=-2)).abs() <= gripper.pad_reach
    between = ahead & beside & (places >= right) & (places <= left)
    lowest, highest = places.where(between, 1e3).amin(-1), places.where(between, -1e3).amax(-1)
    return _gaps(points, axis, lowest, highest)


@once
def forward(points: Points) -> Tensor:
    """Unit vector (B, 3, 1) from the hand to the finger tips."""
    way = tool_centre(points) - centre(points, "hand")
    return (way / way.norm(dim=-1, keepdim=True).clamp_min(1e-6)).unsqueeze(-1)


def _gaps(points: Points, axis: Tensor, lowest: Tensor, highest: Tensor) -> Tensor:
    """Gaps (B, 2) of both fingers to what reaches from ``lowest`` to ``highest`` (B,) along their axis (B, 3, 1)."""
    left, right = (along(points[finger], axis) for finger in ("left_gripper", "right_gripper"))
    return torch.stack([left.amin(-1) - highest, lowest - right.amax(-1)], -1)


def width_between(points: Points, name: str) -> Tensor:
    """Extent (B,) of an object along the fingers' axis: what the fingers have to span."""
    places = along(points[name], fingers_axis(points))
    return places.amax(-1) - places.amin(-1)


@once
def fingers_axis(points: Points) -> Tensor:
    """Unit vector (B, 3, 1) from the right finger's centre to the left one's."""
    axis = centre(points, "left_gripper") - centre(points, "right_gripper")
    return (axis / axis.norm(dim=-1, keepdim=True).clamp_min(1e-6)).unsqueeze(-1)


def along(points: Tensor, axis: Tensor) -> Tensor:
    """Coordinates (B, n) of points (B, n, 3) along an axis (B, 3, 1)."""
    return (axis.transpose(-1, -2) @ points.transpose(-1, -2)).squeeze(-2)


def level(way: Tensor) -> Tensor:
    """Horizontal unit vector (B, 3, 1) along the ways (B, 3)."""
    flat = torch.cat([way[..., :2], torch.zeros_like(way[..., 2:])], -1)
    return (flat / flat.norm(dim=-1, keepdim=True).clamp_min(1e-6)).unsqueeze(-1)


def squared(cloud: Tensor, front: Tensor) -> Tensor:
    """A horizontal unit vector (B, 3, 1), turned so that a box's cloud (B, n, 3) is narrowest across it.

    Means of clouds that lie close to each other tell a direction to some degrees only; a box's sides tell it to tenths
    of one. Directions within 16 degrees of the given one are tried.
    """
    cloud = cloud[..., :_SIDE_POINTS, :]
    leaves = cloud.requires_grad or front.requires_grad
    if not leaves and (cloud == cloud[:1]).all() and ((front * front[:1]).sum((-2, -1)) >= _SAME_WAY).all():
        return _squared(cloud[:1], front[:1]).expand_as(front)  # a body that stands still in every sample
    return _squared(cloud, front)


def _squared(cloud: Tensor, front: Tensor) -> Tensor:
    angles = torch.linspace(-_MOST_TURN, _MOST_TURN, _TURNS, dtype=cloud.dtype, device=cloud.device)
    step = 2 * _MOST_TURN / (_TURNS - 1)
    side = across(front)
    sides = torch.cos(angles) * side - torch.sin(angles) * front  # (B, 3, K)
    places = sides.transpose(-1, -2) @ cloud.transpose(-1, -2)  # (B, K, n)
    width = places.amax(-1) - places.amin(-1)
    best = width.argmin(-1, keepdim=True).clamp(1, _TURNS - 2)
    before, here, after = (width.gather(-1, best + k) for k in (-1, 0, 1))
    steepest = torch.maximum(before - here, after - here).clamp_min(1e-6)  # on both sides of a box's angle
    turn = angles[best] + 0.5 * step * ((before - after) / steepest).clamp(-1.0, 1.0)
    return torch.cos(turn).unsqueeze(-1) * front + torch.sin(turn).unsqueeze(-1) * side


def across(front: Tensor) -> Tensor:
    """Horizontal unit vector (B, 3, 1) a quarter turn to the left of a horizontal one."""
    x, y, z = front.unbind(-2)
    return torch.stack([-y, x, z], -2)


def near_and_shut(points: Points, action: Tensor, name: str, gripper: Gripper = PANDA) -> Tensor:
    """Bool (B,): tool centre within 2.5 cm of the object's, gripper commanded shut (paper, appendix "Cost")."""
    near = tool_distance(points, name, gripper) <= _CLOSE
    return near & (action[..., -1] < 0)


def pinched(points: Points, action: Tensor, name: str, gripper: Gripper = PANDA) -> Tensor:
    """Bool (B,): a shutting gripper, its fingers stopped by that part of the object which is between them."""
    gaps = pad_gaps(points, name, gripper)
    touching = ((gaps >= _DEEPEST) & (gaps <= _LOOSEST)).all(-1) & (gaps.sum(-1) <= gripper.pressed)
    near = tool_distance(points, name, gripper) <= _HELD
    return touching & near & (action[..., -1] < _HALF_SHUT)


def stopped(points: Points, velocity: Points, action: Tensor, name: str) -> Tensor:
    """Bool (B,): a shutting gripper that presses on a part of the object, or whose fingers stop close to one.

    As :func:`pinched` for an object of any shape, whose sides few points tell to a millimetre, held anywhere.
    """
    gaps = pad_gaps(points, name)
    pressing = (gaps <= _LOOSEST).all(-1)
    stopping = (gaps <= _SPARSE).all(-1) & (closing(points, velocity).abs() <= _STOPPED)
    fits = gaps.sum(-1) >= -MOST_SUNK  # else they are shut beside the object, or in front of it
    return (pressing | stopping) & fits & (action[..., -1] < _HALF_SHUT)


def closing(points: Points, velocity: Points) -> Tensor:
    """How much (B,) nearer the fingers have come to each other in the last step, metres."""
    apart = velocity["left_gripper"].mean(-2) - velocity["right_gripper"].mean(-2)
    return -(apart.unsqueeze(-2) @ fingers_axis(points)).flatten(-2).squeeze(-1)


@once
def tool_distance(points: Points, name: str, gripper: Gripper = PANDA) -> Tensor:
    """Distance (B,) from the tool centre to an object's centre."""
    return (centre(points, name) - tool_centre(points, gripper)).norm(dim=-1)


@once
def fingers_apart(points: Points) -> Tensor:
    """Distance (B,) between the centres of the fingers' clouds: of a Panda 10.7 cm when open, 2.7 cm shut."""
    return (centre(points, "left_gripper") - centre(points, "right_gripper")).norm(dim=-1)


def opening(points: Points, gripper: Gripper = PANDA) -> Tensor:
    """Distance (B,) between the pads, as the fingers' centres tell it."""
    return (fingers_apart(points) - gripper.shut_apart).clamp_min(0.0)


@once
def outside_fingers(points: Points, name: str, gripper: Gripper = PANDA) -> Tensor:
    """Soft bool (B,): the object is not between the finger tips."""
    return torch.sigmoid((tool_distance(points, name, gripper) - _BETWEEN) / 0.002)


@once
def crushed(points: Points, name: str) -> Tensor:
    """Soft bool (B,): a pad is deeper in the object than one that holds it."""
    return torch.sigmoid(-(finger_gaps(points, name).amin(-1) + _SUNK) / 0.002)


def firmness(points: Points, action: Tensor, name: str, gripper: Gripper = PANDA) -> Tensor:
    """Soft form (B,) of :func:`pinched`, in [0, 1]; a model lets the pads sink deeper."""
    return _pressing(points, name, gripper) * (action[..., -1] < 0)


@once
def _pressing(points: Points, name: str, gripper: Gripper = PANDA) -> Tensor:
    """Soft bool (B,): both pads touch the object, which is between them."""
    gaps = finger_gaps(points, name)
    pressing = torch.sigmoid((0.001 - gaps.amax(-1)) / 0.0007) * torch.sigmoid((gaps.amin(-1) + _SUNK) / 0.001)
    return pressing * torch.sigmoid((0.020 - tool_distance(points, name, gripper)) / 0.002)
