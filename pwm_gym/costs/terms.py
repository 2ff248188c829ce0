"""Reusable terms on the clouds of a parallel gripper. Lengths in metres, in the robot base's frame."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

__all__ = ["centre", "finger_gaps", "near_and_shut", "pinched", "speed", "tool_centre", "width_between"]

Points = Mapping[str, Tensor]

_TOOL_RATIO = 0.355  # (tool - fingers) / (fingers - hand) along the Panda hand's axis, of its collision meshes
_CLOSE = 0.025  # the paper's grasp distance
# Metres. ManiSkill's pads sink 1.6 to 2.8 mm into an object that they hold; a model may see it 2 mm nearer to one pad.
_DEEPEST, _LOOSEST, _PRESSED = -0.008, 0.001, -0.001


def centre(points: Points, name: str) -> Tensor:
    """Mean (B, 3) of an entity's points."""
    return points[name].mean(-2)


def tool_centre(points: Points) -> Tensor:
    """Point (B, 3) between the finger tips: on the line from the hand's centre through the fingers' centre."""
    fingers = 0.5 * (centre(points, "left_gripper") + centre(points, "right_gripper"))
    return fingers + _TOOL_RATIO * (fingers - centre(points, "hand"))


def finger_gaps(points: Points, name: str) -> Tensor:
    """Gaps (B, 2) between each finger's inner side and the object's, along the fingers' axis.

    Zero: touching. Slightly negative: pressing. More: the finger is past that side, beside or above the object.
    """
    left, right = points["left_gripper"], points["right_gripper"]
    axis = _fingers_axis(points)
    along = (points[name] @ axis).squeeze(-1)
    left_gap = (left @ axis).squeeze(-1).amin(-1) - along.amax(-1)
    right_gap = along.amin(-1) - (right @ axis).squeeze(-1).amax(-1)
    return torch.stack([left_gap, right_gap], -1)


def width_between(points: Points, name: str) -> Tensor:
    """Extent (B,) of an object along the fingers' axis: what the fingers have to span."""
    along = (points[name] @ _fingers_axis(points)).squeeze(-1)
    return along.amax(-1) - along.amin(-1)


def _fingers_axis(points: Points) -> Tensor:
    """Unit vector (B, 3, 1) from the right finger's centre to the left one's."""
    axis = centre(points, "left_gripper") - centre(points, "right_gripper")
    return (axis / axis.norm(dim=-1, keepdim=True).clamp_min(1e-6)).unsqueeze(-1)


def near_and_shut(points: Points, action: Tensor, name: str) -> Tensor:
    """Bool (B,): tool centre within 2.5 cm of the object's, gripper commanded shut (paper, appendix "Cost")."""
    near = (tool_centre(points) - centre(points, name)).norm(dim=-1) <= _CLOSE
    return near & (action[..., -1] < 0)


def pinched(points: Points, action: Tensor, name: str) -> Tensor:
    """Bool (B,): near and shut, and the fingers stopped at the object's sides, pressing together, with it between."""
    gaps = finger_gaps(points, name)
    touching = ((gaps >= _DEEPEST) & (gaps <= _LOOSEST)).all(-1)
    return touching & (gaps.sum(-1) <= _PRESSED) & near_and_shut(points, action, name)


def speed(velocity: Points, name: str) -> Tensor:
    """Speed (B,) of an entity's centre, metres a step."""
    return velocity[name].mean(-2).norm(dim=-1)
