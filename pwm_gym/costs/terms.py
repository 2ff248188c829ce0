"""Reusable terms on the clouds of a parallel gripper. Lengths in metres, in the robot base's frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Concatenate, ParamSpec

import torch
from torch import Tensor

__all__ = [
    "centre",
    "finger_gaps",
    "near_and_shut",
    "pad_gaps",
    "pinched",
    "speed",
    "spin",
    "tool_centre",
    "width_between",
]

Points = Mapping[str, Tensor]
P = ParamSpec("P")

_TOOL_RATIO = 0.355  # (tool - fingers) / (fingers - hand) along the Panda hand's axis, of its collision meshes
_CLOSE = 0.025  # the paper's grasp distance
# Metres. ManiSkill's pads sink 0.3 mm (half shut) to 2.8 mm into an object that they hold, and 8 mm into the width of a
# corner; a model may see it 2 mm nearer to one pad.
_DEEPEST, _LOOSEST, _PRESSED = -0.008, 0.001, -0.0005
_PAD_HALF_WIDTH, _PAD_END = 0.014, 0.012  # of the fingers' pads: to either side of the tool centre, and beyond it
_HELD = 0.036  # how far from an object's centre its corner can be held
_HALF_SHUT = 0.2  # a gripper commanded below this shuts on an object of 4 cm


def _once(term: Callable[Concatenate[Points, P], Tensor]) -> Callable[Concatenate[Points, P], Tensor]:
    """Decorator: points that keep a memo (an environment's and a planner's do) form a quantity once.

    All terms then share the tensor, which none may change in place.
    """

    @wraps(term)
    def formed(points: Points, *args: P.args, **kwargs: P.kwargs) -> Tensor:
        memo = getattr(points, "memo", None)
        if memo is None:
            return term(points, *args, **kwargs)
        key = (term, args, tuple(kwargs.items()))
        if key not in memo:
            memo[key] = term(points, *args, **kwargs)
        return memo[key]

    return formed


@_once
def centre(points: Points, name: str) -> Tensor:
    """Mean (B, 3) of an entity's points."""
    return points[name].mean(-2)


@_once
def tool_centre(points: Points) -> Tensor:
    """Point (B, 3) between the finger tips: on the line from the hand's centre through the fingers' centre."""
    fingers = 0.5 * (centre(points, "left_gripper") + centre(points, "right_gripper"))
    return fingers + _TOOL_RATIO * (fingers - centre(points, "hand"))


@_once
def finger_gaps(points: Points, name: str) -> Tensor:
    """Gaps (B, 2) between each finger's inner side and the object's, along the fingers' axis.

    Zero: touching. Slightly negative: pressing. More: the finger is past that side, beside or above the object.
    """
    axis = _fingers_axis(points)
    along = _along(points[name], axis)
    return _gaps(points, axis, along.amin(-1), along.amax(-1))


@_once
def pad_gaps(points: Points, name: str) -> Tensor:
    """Gaps (B, 2) as :func:`finger_gaps`, to that part of the object which is between the fingers' pads.

    Huge where no part is.
    """
    axis = _fingers_axis(points)
    tool, object_points = tool_centre(points), points[name]
    forward = tool - centre(points, "hand")
    forward = (forward / forward.norm(dim=-1, keepdim=True).clamp_min(1e-6)).unsqueeze(-1)
    sideways = torch.cross(axis, forward, dim=-2)
    offset = object_points - tool.unsqueeze(-2)
    between = (_along(offset, sideways).abs() <= _PAD_HALF_WIDTH) & (_along(offset, forward) <= _PAD_END)
    along = _along(object_points, axis)
    return _gaps(points, axis, along.where(between, 1e3).amin(-1), along.where(between, -1e3).amax(-1))


def _gaps(points: Points, axis: Tensor, lowest: Tensor, highest: Tensor) -> Tensor:
    """Gaps (B, 2) of both fingers to what reaches from ``lowest`` to ``highest`` (B,) along their axis (B, 3, 1)."""
    left, right = (_along(points[finger], axis) for finger in ("left_gripper", "right_gripper"))
    return torch.stack([left.amin(-1) - highest, lowest - right.amax(-1)], -1)


def width_between(points: Points, name: str) -> Tensor:
    """Extent (B,) of an object along the fingers' axis: what the fingers have to span."""
    along = _along(points[name], _fingers_axis(points))
    return along.amax(-1) - along.amin(-1)


@_once
def _fingers_axis(points: Points) -> Tensor:
    """Unit vector (B, 3, 1) from the right finger's centre to the left one's."""
    axis = centre(points, "left_gripper") - centre(points, "right_gripper")
    return (axis / axis.norm(dim=-1, keepdim=True).clamp_min(1e-6)).unsqueeze(-1)


def _along(points: Tensor, axis: Tensor) -> Tensor:
    """Coordinates (B, n) of points (B, n, 3) along an axis (B, 3, 1)."""
    return (axis.transpose(-1, -2) @ points.transpose(-1, -2)).squeeze(-2)


def near_and_shut(points: Points, action: Tensor, name: str) -> Tensor:
    """Bool (B,): tool centre within 2.5 cm of the object's, gripper commanded shut (paper, appendix "Cost")."""
    near = (tool_centre(points) - centre(points, name)).norm(dim=-1) <= _CLOSE
    return near & (action[..., -1] < 0)


def pinched(points: Points, action: Tensor, name: str) -> Tensor:
    """Bool (B,): a shutting gripper, its fingers stopped by that part of the object which is between them."""
    gaps = pad_gaps(points, name)
    touching = ((gaps >= _DEEPEST) & (gaps <= _LOOSEST)).all(-1) & (gaps.sum(-1) <= _PRESSED)
    near = (tool_centre(points) - centre(points, name)).norm(dim=-1) <= _HELD
    return touching & near & (action[..., -1] < _HALF_SHUT)


def speed(velocity: Points, name: str) -> Tensor:
    """Speed (B,) of an entity's centre, metres a step."""
    return velocity[name].mean(-2).norm(dim=-1)


def spin(points: Points, velocity: Points, name: str) -> Tensor:
    """Turn (B,) of an entity about the vertical axis, radians a step: least squares over its points."""
    offset = (points[name] - points[name].mean(-2, keepdim=True))[..., :2]
    moved = (velocity[name] - velocity[name].mean(-2, keepdim=True))[..., :2]
    torque = (offset[..., 0] * moved[..., 1] - offset[..., 1] * moved[..., 0]).sum(-1)
    return torque / offset.square().sum((-1, -2)).clamp_min(1e-9)
