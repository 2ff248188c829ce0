"""What clouds tell of a hinged door with a latch, in a frame that stands upright: terms as in :mod:`.terms`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points, across, along, level, once, squared
from pwm_gym.costs.terms import Info, Place, Term

__all__ = ["ADROIT_DOOR", "Door", "angle", "handle", "latch_angle", "opened"]

_SHARP = 0.003  # metres over which a point comes to count as one of the handle's


@dataclass(frozen=True)
class Door:
    """A door that hangs on its frame's right post and turns about the vertical axis; lengths in metres."""

    frame: str
    door: str
    latch: str
    post: float
    """Radius of a post."""
    along: float
    """From the hinge along the door to the latch's axis."""
    below: float
    """Of the latch's axis under the middle of the frame."""
    handle: tuple[float, float]
    """From the latch's axis to the middle of its handle: beside it where the latch is shut, and before the door."""
    handle_begins: float
    """Before the door, where the latch is a handle alone."""


ADROIT_DOOR = Door("frame", "door", "latch", 0.05, 0.46, 0.025, (0.15, 0.15), 0.12)
"""Of Gymnasium-Robotics' AdroitHandDoor."""


@once
def _hinge(points: Points, door: Door) -> Tensor:
    """Middle (B, 3) of the post that the door hangs on."""
    middle = contacts.middle(points, door.frame)
    return torch.cat([points[door.frame][..., :1].amax(-2) - door.post, middle[..., 1:]], -1)


@once
def _direction(points: Points, door: Door) -> Tensor:
    """Horizontal unit vector (B, 3, 1) from the hinge along the door."""
    way = contacts.centre(points, door.door) - _hinge(points, door)
    return squared(points[door.door], level(way))


def angle(door: Door) -> Term:
    """How far (B,) the door is open, radians; 0 where it is shut."""

    def term(points: Points, info: Info) -> Tensor:
        way = _direction(points, door).squeeze(-1)
        return torch.atan2(-way[..., 1], -way[..., 0])

    return term


def _latch(points: Points, door: Door) -> tuple[Tensor, Tensor, Tensor]:
    """Origin (B, 3) of the latch, and unit vectors (B, 3) of the door: towards its hinge, and through it."""
    way = _direction(points, door)
    origin = _hinge(points, door) + door.along * way.squeeze(-1)
    origin = torch.cat([origin[..., :2], origin[..., 2:] - door.below], -1)
    return origin, -way.squeeze(-1), -across(way).squeeze(-1)


def latch_angle(door: Door) -> Term:
    """How far (B,) the latch is turned, radians: its handle goes down."""

    def term(points: Points, info: Info) -> Tensor:
        origin, beside, through = _latch(points, door)
        offset = points[door.latch] - origin.unsqueeze(-2)
        before = -along(offset, through.unsqueeze(-1))
        weight = torch.sigmoid((before - door.handle_begins) / _SHARP)
        total = weight.sum(-1).clamp_min(1e-6)
        ahead = (weight * along(offset, beside.unsqueeze(-1))).sum(-1) / total
        above = (weight * offset[..., 2]).sum(-1) / total
        return torch.atan2(-above, ahead)

    return term


def handle(door: Door) -> Place:
    """Middle (B, 3) of the latch's handle."""
    turned = latch_angle(door)

    def place(points: Points, info: Info) -> Tensor:
        origin, beside, through = _latch(points, door)
        down = turned(points, info).unsqueeze(-1)
        up = torch.zeros_like(origin) + origin.new_tensor([0.0, 0.0, 1.0])
        return origin + door.handle[0] * (down.cos() * beside - down.sin() * up) - door.handle[1] * through

    return place


def opened(door: Door, least: float) -> Term:
    """Bool (B,): the door is open by ``least`` radians."""
    turned = angle(door)
    return lambda points, info: turned(points, info) >= least
