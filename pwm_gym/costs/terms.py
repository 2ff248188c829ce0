"""Shared terms of costs: each function here makes a term, ``(points, info) -> (B,)``, for the entities it names.

The first ones are a simulator's shaped rewards; they lie in [0, 1], and a task gives them negative weights. The others
are what planners descend: a grasp from above that cannot be fooled in a model, a carry. What sets an object down is in
:mod:`.placing`.

Example:
    >>> from pwm_gym.costs import register_terms, terms
    >>> cost = register_terms("tidy_doctest", {"approach": (1.5, terms.approach("mug"))})
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.motion import angular_velocity, joint_speed, speed
from pwm_gym.robots.gripper import PANDA, Gripper
from pwm_gym.robots.speeds import JointSpeeds

__all__ = [
    "Place",
    "Term",
    "approach",
    "at_rest",
    "carry",
    "centre",
    "closeness",
    "disturbance",
    "effort",
    "finger_blocking",
    "goal_position",
    "grasped",
    "ground_contact",
    "middle",
    "misalignment",
    "near",
    "near_and_shut",
    "nearness",
    "object_still",
    "on_top",
    "pinch",
    "place",
    "premature_close",
    "reach",
    "resting_on",
    "settle",
    "still",
    "tilt",
    "tool",
    "tool_of",
    "ungrasp",
    "way_from_above",
]

Info = Mapping[str, Any]
Term = Callable[[Points, Info], Tensor]
"""(points, info) -> (B,)."""
Place = Callable[[Points, Info], Tensor]
"""(points, info) -> position (B, 3), metres."""

_CLEAR = 0.05  # metres over an object's centre at which open fingers clear its top
_FULL_OPENING = 0.08  # metres between the pads of an open Panda gripper
_AJAR = 0.007  # metres by which a gripper that counts as open may be shut
_UPRIGHT = 0.035  # sine of 2 degrees: a hand that points straight down, as far as its points tell
_DOWN, _UP = 0.8, 1.5  # of a way from above: a metre too high, and a metre too low, in metres beside


# Places, and rules about them -------------------------------------------------------------------------------------


def goal_position(points: Points, info: Info) -> Tensor:
    """The place (B, 3) that the goal names."""
    return info["goal"]


def on_top(name: str, height: float) -> Place:
    """The place ``height`` metres over an object's centre."""

    def place(points: Points, info: Info) -> Tensor:
        centre = contacts.centre(points, name)
        return torch.cat([centre[..., :2], centre[..., 2:] + height], -1)

    return place


def _distance(name: str, target: Place) -> Term:
    """Distance (B,) from an object's centre to a place."""
    return lambda points, info: (contacts.centre(points, name) - target(points, info)).norm(dim=-1)


def nearness(place: Place, target: Place) -> Term:
    """How near two places are: 1 where they coincide, 1 - tanh(5 d) at ``d`` metres, as ManiSkill's rewards have it."""
    return lambda points, info: 1.0 - torch.tanh(5.0 * (place(points, info) - target(points, info)).norm(dim=-1))


def middle(name: str) -> Place:
    """Middle (B, 3) of an object's extents, metres."""
    return lambda points, info: contacts.middle(points, name)


def tool(points: Points, info: Info) -> Tensor:
    """The tool centre (B, 3), metres."""
    return contacts.tool_centre(points)


def tool_of(gripper: Gripper) -> Place:
    """The tool centre (B, 3) of a gripper, metres."""
    return lambda points, info: contacts.tool_centre(points, gripper)


def centre(name: str) -> Place:
    """Mean (B, 3) of an object's points, metres."""
    return lambda points, info: contacts.centre(points, name)


def near(name: str, target: Place, radius: float) -> Term:
    """Bool (B,): the object's centre is within ``radius`` metres of a place."""
    distance = _distance(name, target)
    return lambda points, info: distance(points, info) <= radius


def resting_on(name: str, target: Place, beside: float, height: float) -> Term:
    """Bool (B,): the object's centre is at a place, within ``beside`` metres in the plane and ``height`` in height."""

    def term(points: Points, info: Info) -> Tensor:
        offset = contacts.centre(points, name) - target(points, info)
        return (offset[..., :2].norm(dim=-1) <= beside) & (offset[..., 2].abs() <= height)

    return term


def at_rest(name: str, period: float, linear: float, angular: float) -> Term:
    """Bool (B,): the object is slower than ``linear`` m/s and ``angular`` rad/s, with control steps of ``period`` s."""

    def term(points: Points, info: Info) -> Tensor:
        turn = angular_velocity(points, info["velocity"], name).norm(dim=-1)
        return (speed(info["velocity"], name) <= linear * period) & (turn <= angular * period)

    return term


def pinch(name: str, gripper: Gripper = PANDA) -> Term:
    """Bool (B,): the contact rule of a grasp, :func:`pwm_gym.costs.contacts.pinched`."""
    return lambda points, info: contacts.pinched(points, info["action"], name, gripper)


def near_and_shut(name: str, gripper: Gripper = PANDA) -> Term:
    """Bool (B,): the paper's rule of a grasp, :func:`pwm_gym.costs.contacts.near_and_shut`."""
    return lambda points, info: contacts.near_and_shut(points, info["action"], name, gripper)


# A simulator's shaped rewards -------------------------------------------------------------------------------------


def reach(name: str, gripper: Gripper = PANDA) -> Term:
    """Nearness of the tool to the object."""
    return nearness(centre(name), tool_of(gripper))


def grasped(name: str, gripper: Gripper = PANDA) -> Term:
    """1 where the object is pinched."""
    return lambda points, info: contacts.pinched(points, info["action"], name, gripper).float()


def place(name: str, target: Place) -> Term:
    """Nearness of the grasped object to a place."""
    held, placed = grasped(name), nearness(centre(name), target)
    return lambda points, info: held(points, info) * placed(points, info)


def still(arm: JointSpeeds, reached: Term) -> Term:
    """Slowness of the arm's joints where the rule ``reached`` holds."""

    def term(points: Points, info: Info) -> Tensor:
        rest = 1.0 - torch.tanh(5.0 * joint_speed(points, info, arm))
        return rest * reached(points, info)

    return term


def ungrasp(name: str) -> Term:
    """How far the fingers have opened around the object; 1 where they do not hold it."""

    def term(points: Points, info: Info) -> Tensor:
        held = contacts.pinched(points, info["action"], name)
        return torch.where(held, contacts.opening(points) / _FULL_OPENING, 1.0)

    return term


def object_still(name: str, period: float) -> Term:
    """Slowness of the object, with control steps of ``period`` seconds."""

    def term(points: Points, info: Info) -> Tensor:
        linear = speed(info["velocity"], name) / period
        angular = angular_velocity(points, info["velocity"], name).norm(dim=-1) / period
        return 1.0 - torch.tanh(10.0 * linear + angular)

    return term


# The planners' cost: a grasp that cannot be fooled ----------------------------------------------------------------


def approach(name: str, finished: Term | None = None, gripper: Gripper = PANDA) -> Term:
    """Distance from tool to object, sharper when near; none where the soft rule ``finished`` holds."""

    def term(points: Points, info: Info) -> Tensor:
        distance = contacts.tool_distance(points, name, gripper)
        value = 5.0 * distance + torch.tanh(distance / 0.02)
        return value if finished is None else value * (1 - finished(points, info))

    return term


def premature_close(name: str, gripper: Gripper = PANDA) -> Term:
    """Shut before the object is between the fingers."""
    open_apart = gripper.shut_apart + gripper.opening - _AJAR

    def term(points: Points, info: Info) -> Tensor:
        shut = ((open_apart - contacts.fingers_apart(points)) / 0.04).clamp(0, 1)
        outside = contacts.outside_fingers(points, name, gripper)
        return shut * torch.maximum(outside, contacts.crushed(points, name))

    return term


def finger_blocking(name: str, gripper: Gripper = PANDA) -> Term:
    """Fingers at the object's height that overlap it along their own axis: coming closer, they would push it."""

    def term(points: Points, info: Info) -> Tensor:
        height = contacts.tool_centre(points, gripper)[..., 2] - contacts.centre(points, name)[..., 2]
        depth = ((_CLEAR - height) / _CLEAR).clamp(0, 1)
        blocked = torch.sigmoid((0.002 - contacts.finger_gaps(points, name).amin(-1)) / 0.002)
        return blocked * depth * contacts.outside_fingers(points, name, gripper)

    return term


def misalignment(name: str, width: float) -> Term:
    """How much wider than ``width`` the object is along the fingers' axis: 0 aligned, 1 on the diagonal of a square."""

    def term(points: Points, info: Info) -> Tensor:
        between = contacts.width_between(points, name)
        return ((between - width) / (0.414 * width)).clamp(0, 1)

    return term


def ground_contact(points: Points, info: Info) -> Tensor:
    """Finger tips nearer than 5 mm to the ground, which would stop the arm; 1 where they touch it."""
    lowest = torch.minimum(points["left_gripper"][..., 2].amin(-1), points["right_gripper"][..., 2].amin(-1))
    return ((0.005 - lowest) / 0.005).clamp(0, 2)


def effort(points: Points, info: Info) -> Tensor:
    """Translations over half a unit: near the edge of the arm's reach the controller finds no pose, and stops."""
    return 4.0 * (info["action"][..., :3].norm(dim=-1) - 0.5).clamp_min(0.0).square()


def tilt(points: Points, info: Info) -> Tensor:
    """Sine of the angle by which the hand does not point straight down, beyond 2 degrees.

    What is pulled and pushed turns the hand step by step, and what it then holds stands askew.
    """
    return (contacts.forward(points).squeeze(-1)[..., :2].norm(dim=-1) - _UPRIGHT).clamp_min(0.0)


def disturbance(name: str, held: bool = True, gripper: Gripper = PANDA) -> Term:
    """Speed of an object in units of 5 mm a step: it is being pushed, or it falls.

    Args:
        name: the object.
        held: whether it may move while it is firmly held.
        gripper: that holds it.
    """

    def term(points: Points, info: Info) -> Tensor:
        pushed = (speed(info["velocity"], name) / 0.005).clamp_max(4.0)
        if not held:
            return pushed
        return pushed * (1 - contacts.firmness(points, info["action"], name, gripper))

    return term


def carry(name: str, target: Place, gripper: Gripper = PANDA, most: float = 4.0, farthest: float = 0.4) -> Term:
    """Nearness of the object to a place, which counts once the grasp is firm.

    Args:
        name: the object.
        target: the place.
        gripper: that holds it.
        most: value at the place; ``most - 8 * farthest`` above 1 makes a grasp worth its while anywhere.
        farthest: distance, metres, beyond which the value falls no further.
    """
    distance = _distance(name, target)

    def term(points: Points, info: Info) -> Tensor:
        firm = contacts.firmness(points, info["action"], name, gripper)
        return firm * closeness(distance(points, info), most, farthest)

    return term


def closeness(distance: Tensor, most: float = 4.0, farthest: float = 0.4) -> Tensor:
    """``most`` at no distance; it falls steeply within 3 cm, and by 8 a metre up to ``farthest`` metres."""
    return most - 8.0 * distance.clamp_max(farthest) - torch.tanh(distance / 0.03)


def settle(name: str, target: Place, arm: JointSpeeds, limit: float) -> Term:
    """Speed of the arm's joints, in units of ``limit`` rad/s, where the object is near its place."""
    distance = _distance(name, target)

    def term(points: Points, info: Info) -> Tensor:
        close = torch.sigmoid((0.015 - distance(points, info)) / 0.003)
        return close * (joint_speed(points, info, arm) / limit).clamp_max(3.0)

    return term


def way_from_above(offset: Tensor, clearance: float, within: float = 0.005, slope: float = 0.04) -> Tensor:
    """Length (B,) of a way that comes to a place from above, metres: up, over it, and down, wherever one begins.

    Args:
        offset: from the place (B, 3).
        clearance: height over the place that it has to have beside it.
        within: distance beside the place up to which it needs no height.
        slope: further distance over which it then needs more and more of the clearance.
    """
    beside, height = offset[..., :2].norm(dim=-1), offset[..., 2]
    needed = clearance * ((beside - within) / slope).clamp(0, 1)
    return beside + _DOWN * height.abs() + (_UP + _DOWN) * (needed - height).clamp_min(0)
