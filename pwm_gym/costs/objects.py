"""Shared terms for objects of any shape, which may be held far from their centre; used as :mod:`.terms` is.

An object's place is the middle of its extents, which stands in for the origin that a simulator's goals are given for.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.grips import finger_overlap, grip
from pwm_gym.costs.motion import joint_speed, speed
from pwm_gym.costs.terms import Info, Place, Term, closeness, middle, nearness, tool, way_from_above
from pwm_gym.robots.speeds import JointSpeeds

__all__ = [
    "aligned",
    "approach",
    "carry",
    "carry_onto",
    "disturbance",
    "finger_blocking",
    "grasped",
    "hand_clear",
    "hand_low",
    "held",
    "lift",
    "misalignment",
    "near",
    "place",
    "placed",
    "premature_close",
    "reach",
    "settle",
    "still",
    "way_to_grip",
]

_TOUCHING, _STOPPED = 0.006, 0.0016  # metres, and metres a step: of fingers that an object has stopped
_AJAR, _SHUT = -0.3, 0.5  # the gripper's command from which it may hold something, and how far below it surely does
_EMPTY = 0.001  # metres between pads that hold nothing
_OFF_PLACE = 0.02  # metres between tool and grip place within which the fingers may shut
_NARROW, _WIDE = 0.06, 0.08  # metres: a width that fits well, and the open Panda gripper's
_HAND_WIDTH = 0.10  # metres from the tool to an object's centre, in the plane, at which the hand is beside it
_FARTHEST, _FAR_SLOPE = 0.45, 0.6  # metres of a way to carry, and what a metre of one beyond them costs
_CLEAR, _LEAVING = 0.02, 0.10  # metres over an object at which the fingers have left it, and that they have to rise


# A simulator's shaped rewards -------------------------------------------------------------------------------------


def _distance(name: str, target: Place) -> Term:
    """Distance (B,) from the object's middle to a place."""
    return lambda points, info: (contacts.middle(points, name) - target(points, info)).norm(dim=-1)


def near(name: str, target: Place, radius: float) -> Term:
    """Bool (B,): the object's middle is within ``radius`` metres of a place."""
    distance = _distance(name, target)
    return lambda points, info: distance(points, info) <= radius


def reach(name: str) -> Term:
    """Nearness of the tool to the object's middle."""
    return nearness(middle(name), tool)


def held(name: str) -> Term:
    """Bool (B,): the contact rule of a grasp anywhere on an object, :func:`pwm_gym.costs.contacts.stopped`."""
    return lambda points, info: contacts.stopped(points, info["velocity"], info["action"], name)


def grasped(name: str) -> Term:
    """1 where the object is held."""
    rule = held(name)
    return lambda points, info: rule(points, info).float()


def place(name: str, target: Place) -> Term:
    """Nearness of the grasped object to a place."""
    grip, arrived = grasped(name), nearness(middle(name), target)
    return lambda points, info: grip(points, info) * arrived(points, info)


def placed(name: str, reached: Term) -> Term:
    """1 where the object is grasped and the rule ``reached`` holds."""
    grip = grasped(name)
    return lambda points, info: grip(points, info) * reached(points, info)


def still(arm: JointSpeeds, reached: Term) -> Term:
    """Slowness of all the arm's joints together where the rule ``reached`` holds."""

    def term(points: Points, info: Info) -> Tensor:
        return (1.0 - torch.tanh(5.0 * joint_speed(points, info, arm, order=2))) * reached(points, info)

    return term


# The planners' cost: a grasp that cannot be fooled ----------------------------------------------------------------


def way_to_grip(name: str) -> Place:
    """Way (B, 3), metres, from the tool to where it would hold the object."""
    return lambda points, info: grip(points, name).place - contacts.tool_centre(points)


@contacts.once
def _off_place(points: Points, name: str) -> Tensor:
    """Distance (B,) from the tool to where it would hold the object."""
    return (contacts.tool_centre(points) - grip(points, name).place).norm(dim=-1)


@contacts.once
def _outside(points: Points, name: str) -> Tensor:
    """Soft bool (B,): the tool is not yet where the fingers may shut."""
    return torch.sigmoid((_off_place(points, name) - _OFF_PLACE) / 0.003)


@contacts.once
def _touching(points: Points, name: str) -> Tensor:
    """Soft bool (B,): both pads touch what is between them, and are not shut beside it."""
    gaps = contacts.pad_gaps(points, name)
    touching = torch.sigmoid((_TOUCHING - gaps.amax(-1)) / 0.001)
    apart = torch.sigmoid((contacts.opening(points) - _EMPTY) / 0.0003)
    return touching * apart * torch.sigmoid((gaps.sum(-1) + contacts.MOST_SUNK) / 0.001)


def _firmness(points: Points, info: Info, name: str) -> Tensor:
    """Soft form (B,) of :func:`pwm_gym.costs.contacts.stopped`, of fingers that are told to shut, not half-way."""
    shut = ((_AJAR - info["action"][..., -1]) / _SHUT).clamp(0.0, 1.0)
    slow = torch.sigmoid((_STOPPED - contacts.closing(points, info["velocity"]).abs()) / 0.0004)
    return _touching(points, name) * slow * shut


def approach(name: str, clearance: float = 0.0) -> Term:
    """Way from the tool to the place where it would hold the object, sharper when near; none once it is held.

    With a ``clearance`` the way is one from above (:func:`pwm_gym.costs.terms.way_from_above`), metres.
    """

    def term(points: Points, info: Info) -> Tensor:
        if clearance:
            offset = contacts.tool_centre(points) - grip(points, name).place
            distance = way_from_above(offset, clearance, within=0.015)
        else:
            distance = _off_place(points, name)
        return (5.0 * distance + torch.tanh(distance / 0.02)) * (1 - _firmness(points, info, name))

    return term


def premature_close(name: str) -> Term:
    """Shut before the object is between the fingers."""

    def term(points: Points, info: Info) -> Tensor:
        shut = (info["action"][..., -1] < 0) * (1 - _touching(points, name))
        return shut * _outside(points, name)

    return term


def finger_blocking(name: str) -> Term:
    """Fingers at the object's height over or in it: coming down, they would push it."""

    def term(points: Points, info: Info) -> Tensor:
        height = contacts.tool_centre(points)[..., 2] - grip(points, name).place[..., 2]
        depth = ((0.05 - height) / 0.05).clamp(0, 1)
        blocked = finger_overlap(points, name) * depth * _outside(points, name)
        return blocked * (1 - _firmness(points, info, name))

    return term


def misalignment(name: str) -> Term:
    """How ill the open fingers fit at the best place: its misfit, and its width from 6 cm up to the open gripper's."""

    def term(points: Points, info: Info) -> Tensor:
        best = grip(points, name)
        fit = best.misfit + ((best.width - _NARROW) / (_WIDE - _NARROW)).clamp(0, 1)
        return fit * (1 - _firmness(points, info, name))

    return term


def disturbance(name: str) -> Term:
    """Speed of an object that is not held, in units of 5 mm a step: it is being pushed, or it falls."""

    def term(points: Points, info: Info) -> Tensor:
        pushed = (speed(info["velocity"], name) / 0.005).clamp_max(4.0)
        return pushed * (1 - _firmness(points, info, name))

    return term


def carry(name: str, target: Place) -> Term:
    """Nearness of the object to a place, which counts once the grasp is firm: up to 4."""
    distance = _distance(name, target)

    def term(points: Points, info: Info) -> Tensor:
        return _firmness(points, info, name) * closeness(distance(points, info))

    return term


def carry_onto(name: str, target: Place, clearance: float, within: float = 0.005, slope: float = 0.04) -> Term:
    """As :func:`carry`, up to 5, of the mean of the object's points, from ``clearance`` metres above the place.

    ``within`` and ``slope`` as of :func:`pwm_gym.costs.terms.way_from_above`.
    """

    def term(points: Points, info: Info) -> Tensor:
        offset = contacts.centre(points, name) - target(points, info)
        way = way_from_above(offset, clearance, within, slope)
        beyond = _FAR_SLOPE * (way - _FARTHEST).clamp_min(0.0)  # from there, too, it is a gain to come nearer
        return _firmness(points, info, name) * (closeness(way, 5.0, _FARTHEST) - beyond)

    return term


def aligned(name: str, target: Place) -> Term:
    """How exactly the held object's middle comes down on a place: 1 high on its axis, 3 in it.

    4 mm beside the axis it is a quarter of that.
    """

    def term(points: Points, info: Info) -> Tensor:
        offset = contacts.middle(points, name) - target(points, info)
        exact = 1.0 - torch.tanh(offset[..., :2].norm(dim=-1) / 0.004)
        low = 1.0 - torch.tanh(offset[..., 2].clamp_min(0.0) / 0.05)
        return _firmness(points, info, name) * exact * (1.0 + 2.0 * low)

    return term


def lift(name: str, height: float) -> Term:
    """How high the held object's lowest point is, as a share of ``height`` metres over the ground: up to 1."""

    def term(points: Points, info: Info) -> Tensor:
        raised = points[name][..., 2].amin(-1) / height
        return _firmness(points, info, name) * raised.clamp(0.0, 1.0)

    return term


def _clearance(points: Points, name: str) -> Tensor:
    """Height (B,), metres, of the finger tips over the object's top, or how far the hand is beside it: the larger."""
    tips = torch.minimum(points["left_gripper"][..., 2].amin(-1), points["right_gripper"][..., 2].amin(-1))
    beside = (contacts.tool_centre(points) - contacts.centre(points, name))[..., :2].norm(dim=-1) - _HAND_WIDTH
    return torch.maximum(tips - points[name][..., 2].amax(-1), beside)


def hand_low(name: str) -> Term:
    """How far the fingers have still to rise until they have left the object, as a share of 10 cm."""
    return lambda points, info: ((_CLEAR + 0.01 - _clearance(points, name)) / _LEAVING).clamp(0.0, 1.0)


def hand_clear(name: str) -> Term:
    """Bool (B,): the fingers are over the object, or beside it: they may go anywhere without pushing it."""
    return lambda points, info: _clearance(points, name) >= _CLEAR


def settle(name: str, target: Place, arm: JointSpeeds, limit: float) -> Term:
    """Speed of the arm's fastest joint, in units of ``limit`` rad/s, where the object is near its place."""
    distance = _distance(name, target)

    def term(points: Points, info: Info) -> Tensor:
        close = torch.sigmoid((0.015 - distance(points, info)) / 0.003)
        return close * (joint_speed(points, info, arm) / limit).clamp_max(3.0)

    return term
