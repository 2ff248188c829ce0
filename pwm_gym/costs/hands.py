"""Shared terms for two hands with straight or bent fingers; used as :mod:`.terms` is. Metres and radians.

The robot is ``two_hands``: a hand's axes are told by the centres of its palm and knuckles.
"""

from __future__ import annotations

from math import atan2, cos, sin

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points, once
from pwm_gym.costs.terms import Info, Place, Term
from pwm_gym.robots.control import Channel, ChannelKind
from pwm_gym.robots.two_hands import FINGERS, SIDES, SIGN, TOOL, TWO_HANDS, boxes

__all__ = [
    "across",
    "arm_speed",
    "axes",
    "bent_thumb",
    "channel_of",
    "command",
    "ground_contact",
    "low",
    "normal",
    "static",
    "tilted",
    "tool",
    "tool_place",
]

_PALM = boxes("left_palm")[0][1]  # centre of the palm in its own frame
_LEAN = atan2(TOOL[0] - _PALM[0], TOOL[2] - _PALM[2])  # of the way from the palm's centre to the tool, from z
_LOWEST = 0.004  # metres over the ground, under which a hand presses on it
_REACH = 0.5  # metres: speed of a hand over that of the arm's joints, where they are not known
_UPRIGHT = 0.035  # sine of 2 degrees


@once
def tool(points: Points, side: str) -> Tensor:
    """Middle (B, 3) of one hand's fingers: its tool centre where they are straight."""
    links = [contacts.centre(points, f"{side}_{finger}_{k}") for finger in FINGERS for k in (1, 2)]
    return torch.stack(links).mean(0)


def tool_place(side: str) -> Place:
    """The same as a place."""
    return lambda points, info: tool(points, side)


@once
def across(points: Points, side: str) -> Tensor:
    """Unit vector (B, 3) along one hand's knuckles: its y axis."""
    first, last = (contacts.centre(points, f"{side}_{finger}_1") for finger in (FINGERS[0], FINGERS[-1]))
    return SIGN[side] * torch.nn.functional.normalize(first - last, dim=-1)


@once
def axes(points: Points, side: str) -> tuple[Tensor, Tensor]:
    """Unit vectors (B, 3) out of one hand's palm (x), and to its finger tips (z); of straight fingers exact."""
    y, way = across(points, side), tool(points, side) - contacts.centre(points, f"{side}_palm")
    leaning = torch.nn.functional.normalize(way - (way * y).sum(-1, keepdim=True) * y, dim=-1)
    beside = torch.linalg.cross(y, leaning)
    return cos(_LEAN) * beside + sin(_LEAN) * leaning, cos(_LEAN) * leaning - sin(_LEAN) * beside


def normal(points: Points, side: str) -> Tensor:
    """Unit vector (B, 3) out of one hand's palm."""
    return axes(points, side)[0]


def tilted(points: Points, info: Info) -> Tensor:
    """Sines of the angles by which hands do not hang upright, beyond 2 degrees, of both together."""
    tilts = [axes(points, side)[1][..., :2].norm(dim=-1) for side in SIDES]
    return (torch.stack(tilts) - _UPRIGHT).clamp_min(0.0).sum(0)


def channel_of(side: str, kind: ChannelKind) -> Channel:
    """What one hand's actions of a kind are."""
    channel = TWO_HANDS.control.channel(side, kind)
    assert channel is not None
    return channel


def command(info: Info, side: str) -> Tensor:
    """Way (B, 3) that one hand is told to go in a step, metres."""
    channel = channel_of(side, "translation")
    return channel.unit * info["action"][..., channel.slice]


def bent_thumb(side: str) -> Term:
    """How far the second joint of one hand's thumb is told to bend, 0 straight to 1."""
    place = channel_of(side, "finger").start + 1
    return lambda points, info: 0.5 * (info["action"][..., place] + 1.0)


@once
def low(points: Points, side: str) -> Tensor:
    """Height (B,) of one hand's lowest point."""
    names = [name for name in TWO_HANDS.driven if name.startswith(side)]
    return torch.stack([points[name][..., 2].amin(-1) for name in names]).amin(0)


def ground_contact(points: Points, info: Info) -> Tensor:
    """How far (B,) hands are lower than 4 mm over the ground, in units of these, both together."""
    depths = [((_LOWEST - low(points, side)) / _LOWEST).clamp(0.0, 2.0) for side in SIDES]
    return torch.stack(depths).sum(0)


def arm_speed(points: Points, info: Info) -> Tensor:
    """Speed (B,) of both arms' fastest joint, rad/s; where joints are not known, as the hands' motion tells it."""
    rate = 1.0 / TWO_HANDS.control.period
    joints = info.get("joints")
    if joints is None:
        speeds = [contacts.centre(info["velocity"], f"{side}_palm").norm(dim=-1) for side in SIDES]
        return rate / _REACH * torch.stack(speeds).amax(0)
    velocity = joints[..., 1, :]
    arms = sum(arm.joints.stop - arm.joints.start for arm in TWO_HANDS.control.arms)
    if velocity.shape[-1] > arms:  # a simulator's joints: an arm, its hand, the other arm, its hand
        velocity = torch.cat([velocity[..., arm.joints] for arm in TWO_HANDS.control.arms], -1)
    return rate * velocity.abs().amax(-1)


def static(limit: float) -> Term:
    """Bool (B,): no joint of either arm is faster than ``limit`` rad/s."""
    return lambda points, info: arm_speed(points, info) <= limit
