"""Shared terms for a machine with a hinged lid, told from the extents of their clouds; used as :mod:`.terms` is.

The machine and the lid are each the same to the left and to the right, and stand upright. Metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points, across, along, level, once, squared
from pwm_gym.costs.terms import Info, Place, Term, middle, nearness
from pwm_gym.sim.coffee_machine import (
    HOLDER_FLOOR,
    LID_JOINT,
    LID_LENGTH,
    MACHINE_FROM,
    MUG_AHEAD,
    OPEN_ANGLE,
    POD_HEIGHT,
    RIM,
    TOWER_TOP,
)

__all__ = ["COFFEE_LID", "Lid", "angle", "before", "behind", "holder", "placed", "seated", "shut", "shut_to"]


_FALLS = radians(75.0)  # below this the lid falls shut by itself
_BEHIND, _HIGH = 0.030, 0.060  # of the tool from the hinge, where it pushes the lid over
_PRESSED = 0.03  # of the tool from the lid's end, where it presses it down


@dataclass(frozen=True)
class Lid:
    """Where the parts of a machine are, from the flat wall at its back and its lowest points.

    All that is high stands at its back.
    """

    widest: float
    """Angle at which it is open."""
    length: float
    """From the hinge to the lid's end."""
    hinge: tuple[float, float]
    """Of the hinge: before the back, and over the lowest point."""
    holder: tuple[float, float]
    """The same of the middle of what stands in the holder."""
    mug: float
    """Of where a mug stands: before the holder."""
    back: float
    """Height from which all that there is stands at the back."""
    name: str = "lid"
    machine: str = "machine"


COFFEE_LID = Lid(
    widest=OPEN_ANGLE,
    length=LID_LENGTH,
    hinge=(LID_JOINT.origin[0] - MACHINE_FROM, LID_JOINT.origin[2]),
    holder=(-MACHINE_FROM, HOLDER_FLOOR + 0.5 * POD_HEIGHT),
    mug=MUG_AHEAD,
    back=0.5 * (TOWER_TOP + RIM + 0.0125),
)
"""Of :mod:`pwm_gym.sim.coffee_machine`."""


@once
def _front(points: Points, lid: Lid) -> Tensor:
    """Horizontal unit vector (B, 3, 1) from the machine's back to its front."""
    cloud = points[lid.machine]
    low = cloud[..., 2].amin(-1, keepdim=True)
    high = (cloud[..., 2] >= low + lid.back).to(cloud.dtype).unsqueeze(-1)  # (B, n, 1)
    tower = (cloud * high).sum(-2) / high.sum(-2).clamp_min(1.0)
    return squared(cloud, level(contacts.centre(points, lid.machine) - tower))


@once
def _point(points: Points, lid: Lid, ahead: float, height: float) -> Tensor:
    """Place (B, 3) amid the machine's width, ``ahead`` of its back and ``height`` over its lowest point."""
    front = _front(points, lid)
    side = across(front)
    back, beside = along(points[lid.machine], front).amin(-1), along(points[lid.machine], side)
    middle = 0.5 * (beside.amin(-1) + beside.amax(-1))
    flat = front.squeeze(-1) * (back + ahead).unsqueeze(-1) + side.squeeze(-1) * middle.unsqueeze(-1)
    raised = points[lid.machine][..., 2].amin(-1) + height
    return torch.cat([flat[..., :2], raised.unsqueeze(-1)], -1)


@once
def angle(points: Points, lid: Lid) -> Tensor:
    """Angle (B,) of the lid; 0 is shut."""
    arm = contacts.centre(points, lid.name) - _point(points, lid, *lid.hinge)
    ahead = along(arm.unsqueeze(-2), _front(points, lid)).squeeze(-1)
    return torch.atan2(arm[..., 2], ahead)


def holder(lid: Lid) -> Place:
    """Where the middle of what stands in the holder is."""
    return lambda points, info: _point(points, lid, *lid.holder)


def before(lid: Lid, name: str) -> Place:
    """Where the mean of an object's points is when it stands before the machine, where a mug belongs."""

    def place(points: Points, info: Info) -> Tensor:
        flat = _point(points, lid, lid.holder[0] + lid.mug, 0.0)
        height = contacts.centre(points, name)[..., 2] - points[name][..., 2].amin(-1)
        return torch.cat([flat[..., :2], flat[..., 2:] + height.unsqueeze(-1)], -1)

    return place


def behind(lid: Lid) -> Place:
    """From where the lid is shut: behind it while it stands, over its end once it falls by itself."""

    def place(points: Points, info: Info) -> Tensor:
        standing = (angle(points, lid) > _FALLS).unsqueeze(-1)
        back = _point(points, lid, lid.hinge[0] - _BEHIND, lid.hinge[1] + _HIGH)
        end = _point(points, lid, lid.hinge[0] + lid.length - _PRESSED, lid.hinge[1])
        return torch.where(standing, back, end)

    return place


def seated(lid: Lid, name: str, beside: float, above: float) -> Term:
    """Bool (B,): an object is in the holder, ``beside`` metres off its axis and ``above`` its floor at the most."""
    place = holder(lid)

    def term(points: Points, info: Info) -> Tensor:
        offset = contacts.middle(points, name) - place(points, info)
        return (offset[..., :2].norm(dim=-1) <= beside) & (offset[..., 2] <= above)

    return term


def shut_to(lid: Lid, most: float) -> Term:
    """Bool (B,): it is open by ``most`` radians at most."""
    return lambda points, info: angle(points, lid) <= most


def placed(lid: Lid, name: str) -> Term:
    """Nearness of an object to its place in the holder."""
    return nearness(middle(name), holder(lid))


def shut(lid: Lid) -> Term:
    """Share of its widest angle by which it is shut."""
    return lambda points, info: 1.0 - (angle(points, lid) / lid.widest).clamp(0.0, 1.0)
