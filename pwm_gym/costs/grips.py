"""Where a parallel gripper that comes from above could hold an object of any shape, told from points alone.

Places on the object and its centre are tried with the fingers as they are turned: what of the object lies between the
open fingers there, what is in the fingers' way, how far off the centre it is. Lengths are in metres, frames the robot
base's.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points, along, once

__all__ = ["Grip", "finger_overlap", "grip"]

_POINTS, _PLACES = 80, 12  # of an object's cloud within the fingers' reach: what is looked at, and tried
_FINGER_LENGTH = 0.03  # below an object's top where the tool can hold it with the hand above it
_OPEN, _OUTER = 0.038, 0.067  # from the tool to an open finger's inner and outer side
_MARGIN = 0.003  # within which a point begins to be in a finger's way
_NOTHING = 0.5  # cost of a place with nothing between the fingers; 1 is a finger that is in the way
_SLIPS = (0.3, 0.9)  # slopes of the held sides along the pads from which they begin to slip, and surely do
_OFF_CENTRE, _FAR = 0.12, 0.25  # from the object's centre, and from the tool, that cost as much as a finger in the way


@dataclass(frozen=True)
class Grip:
    """The best place to hold an object at, for the fingers' present turn."""

    place: Tensor
    """Tool centre (B, 3)."""
    width: Tensor
    """Width (B,) of what would be between the fingers."""
    misfit: Tensor
    """How ill (B,) open fingers fit there: 1 where one is in the way, 0.5 where nothing would be held, 1 where the pads
    would slip off slanting sides, and 1 for each 12 cm off the object's centre."""


@once
def grip(points: Points, name: str) -> Grip:
    """Best place to hold the object ``name`` at, of those that are tried."""
    (cloud, counts), centre = _within_reach(points, name), contacts.centre(points, name)
    tried = torch.cat([centre.unsqueeze(-2), cloud[..., :_PLACES, :]], -2)  # (B, K, 3)
    height = _height(points, name)
    axis, sideways = _directions(points)
    across = along(tried, axis).unsqueeze(-1) - along(cloud, axis).unsqueeze(-2)  # (B, K, n)
    beside = along(tried, sideways).unsqueeze(-1) - along(cloud, sideways).unsqueeze(-2)
    reached = (beside.abs() <= contacts.PAD_HALF_WIDTH) & counts.unsqueeze(-2)
    distance = across.abs()
    in_way = ((distance - _OPEN) / _MARGIN).clamp(0.0, 1.0) * ((_OUTER - distance) / _MARGIN).clamp(0.0, 1.0)
    between = reached & (distance <= _OPEN)
    off_centre = (tried - centre.unsqueeze(-2))[..., :2].norm(dim=-1)
    misfit = (in_way * reached).amax(-1) + _NOTHING * ~between.any(-1) + off_centre / _OFF_CENTRE  # (B, K)
    misfit = misfit + _slipping(across, beside, between)
    way = (tried - contacts.tool_centre(points).unsqueeze(-2))[..., :2].norm(dim=-1)
    best = (misfit + way / _FAR).argmin(-1, keepdim=True)  # (B, 1)
    found = tried.gather(-2, best.unsqueeze(-1).expand(-1, -1, 3)).squeeze(-2)
    chosen = best.unsqueeze(-1).expand(-1, -1, across.shape[-1])
    spread, held = across.gather(-2, chosen).squeeze(-2), between.gather(-2, chosen).squeeze(-2)  # (B, n)
    low, high = spread.where(held, 1e3).amin(-1), spread.where(held, -1e3).amax(-1)
    middle = torch.where(held.any(-1), 0.5 * (low + high), 0.0).unsqueeze(-1)
    place = found - middle * axis.squeeze(-1)  # amid what is between the fingers
    place = torch.cat([place[..., :2], height.unsqueeze(-1)], -1)
    return Grip(place, (high - low).clamp_min(0.0), misfit.gather(-1, best).squeeze(-1))


def _slipping(across: Tensor, beside: Tensor, between: Tensor) -> Tensor:
    """How surely (B, K) pads would slip off what is between them, as off a cup that is pinched beside its middle.

    Told by how much farther out one side of it is under one half of a pad than under the other; surely where one half
    has nothing to hold.

    Args:
        across: places (B, K, n) of points along the fingers' axis.
        beside: the same across that axis, from the pads' middle.
        between: bool (B, K, n), which of them are between the pads.
    """
    low, high = [], []
    for half in (between & (beside < 0.0), between & (beside >= 0.0)):
        low.append(across.where(half, 1e3).amin(-1))
        high.append(across.where(half, -1e3).amax(-1))
    rise = torch.maximum((low[0] - low[1]).abs(), (high[0] - high[1]).abs()) / contacts.PAD_HALF_WIDTH
    begins, surely = _SLIPS
    return ((rise - begins) / (surely - begins)).clamp(0.0, 1.0)


def finger_overlap(points: Points, name: str) -> Tensor:
    """How much (B,) a finger that came down where it is would hit the object, in [0, 1]."""
    cloud, counts = _within_reach(points, name)
    axis, sideways = _directions(points)
    beside = along(cloud - contacts.tool_centre(points).unsqueeze(-2), sideways).abs() <= contacts.PAD_HALF_WIDTH
    places, most = along(cloud, axis), []
    for finger in ("left_gripper", "right_gripper"):
        reach = along(points[finger], axis)
        inner, outer = reach.amin(-1, keepdim=True), reach.amax(-1, keepdim=True)
        depth = torch.minimum(places - inner, outer - places) + _MARGIN
        most.append(((depth / _MARGIN).clamp(0.0, 1.0) * (beside & counts)).amax(-1))
    return torch.maximum(*most)


@once
def _height(points: Points, name: str) -> Tensor:
    """Height (B,) of the tool: the object's centre, or not far below the top of a tall one."""
    return torch.maximum(contacts.centre(points, name)[..., 2], points[name][..., 2].amax(-1) - _FINGER_LENGTH)


@once
def _within_reach(points: Points, name: str) -> tuple[Tensor, Tensor]:
    """Points (B, n, 3) of the object that fingers reach from above, the first of which are well spread.

    And bool (B, n), false for those that only fill up where there are fewer.
    """
    cloud = points[name]
    reached = cloud[..., 2] >= _height(points, name).unsqueeze(-1) - contacts.PAD_END
    order = torch.arange(cloud.shape[-2], device=cloud.device) + cloud.shape[-2] * ~reached
    chosen = order.topk(min(_POINTS, cloud.shape[-2]), -1, largest=False).indices
    return cloud.gather(-2, chosen.unsqueeze(-1).expand(*chosen.shape, 3)), reached.gather(-1, chosen)


@once
def _directions(points: Points) -> tuple[Tensor, Tensor]:
    """Unit vectors (B, 3, 1) along which the fingers move, and across that and their length."""
    axis = contacts.fingers_axis(points)
    return axis, torch.cross(axis, contacts.forward(points), dim=-2)
