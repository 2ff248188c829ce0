"""Terms of planners' costs that set an object down at its place, used as :mod:`.terms` are. Metres."""

from __future__ import annotations

import torch
from torch import Tensor

from pwm_gym.costs import contacts, terms
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.motion import speed
from pwm_gym.costs.terms import Info, Place, Term
from pwm_gym.robots.gripper import PANDA, Gripper

__all__ = ["carry_onto", "finished", "released", "retreat"]


def carry_onto(
    name: str,
    target: Place,
    clearance: float = 0.02,
    gripper: Gripper = PANDA,
    most: float = 5.0,
    farthest: float = 0.45,
) -> Term:
    """As :func:`pwm_gym.costs.terms.carry`, by a way from above: lifted first, over the place, then lowered.

    Args:
        name: the object.
        target: the place where it shall stand.
        clearance: height over the place, metres, that it has to have 4.5 cm beside it; it falls to 0 above the place.
        gripper: that holds it.
        most: value at the place.
        farthest: length of the way, metres, beyond which the value falls no further.
    """

    def term(points: Points, info: Info) -> Tensor:
        way = terms.way_from_above(contacts.centre(points, name) - target(points, info), clearance)
        firm = contacts.firmness(points, info["action"], name, gripper)
        return firm * terms.closeness(way, most, farthest)

    return term


def _set_down(name: str, target: Place) -> Term:
    """Soft bool (B,): the object stands at its place, and hardly moves."""

    def term(points: Points, info: Info) -> Tensor:
        offset = contacts.centre(points, name) - target(points, info)
        there = torch.sigmoid((0.014 - offset[..., :2].norm(dim=-1)) / 0.002)
        down = torch.sigmoid((0.0035 - offset[..., 2].abs()) / 0.0005)
        slow = torch.sigmoid((0.002 - speed(info["velocity"], name)) / 0.0005)
        return there * down * slow

    return term


def released(name: str, target: Place) -> Term:
    """An object set down at its place with no command to hold it: up to 7.5, from 6 while the fingers still touch it.

    Always more than :func:`carry_onto` gives for holding it there, so that opening the fingers pays at once.
    """
    set_down = _set_down(name, target)

    def term(points: Points, info: Info) -> Tensor:
        opened = (contacts.finger_gaps(points, name).amin(-1) / 0.01).clamp(0, 1)
        free = info["action"][..., -1] >= 0
        return set_down(points, info) * free * (6.0 + 1.5 * opened)

    return term


def finished(name: str, target: Place) -> Term:
    """Soft bool (B,): the object stands at its place and the gripper is commanded open."""
    set_down = _set_down(name, target)
    return lambda points, info: set_down(points, info) * (info["action"][..., -1] >= 0)


def retreat(name: str, target: Place, height: float = 0.06) -> Term:
    """Distance of the tool, in units of ``height``, from ``height`` metres over an object that stands released."""
    rule = finished(name, target)
    above = terms.on_top(name, height)

    def term(points: Points, info: Info) -> Tensor:
        distance = (above(points, info) - contacts.tool_centre(points)).norm(dim=-1)
        return rule(points, info) * (distance / height).clamp_max(2.0)

    return term
