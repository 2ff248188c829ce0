"""Shared terms and stages for two hands that put a lid on a box, told from the extents of their clouds. Metres.

Lid and box stand upright; each is the same to the left and to the right. Both hands press on the lid's long sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.costs import contacts, hands
from pwm_gym.costs.contacts import Points, along, once, squared
from pwm_gym.costs.motion import speed
from pwm_gym.costs.stages import Stage
from pwm_gym.costs.terms import Info, Place, Term, way_from_above
from pwm_gym.robots.two_hands import FACE, SIDES, SIGN
from pwm_gym.sim.lidded_box import BESIDE, GRIP_HEIGHT, LID_HALF, ON_BOX, PRESSED, SQUEEZE

__all__ = ["LIDDED_BOX", "LiddedBox", "apart", "brought", "heading", "held", "reach", "released", "seated", "sequence"]

_OUTSIDE = 0.045  # gap from where hands go in
_CLEARANCE = 0.11  # over where they hold it, from where hands that come from beside pass over the box
_READY = (0.010, 0.010, 0.09)  # along the side, in height, and gap at most, of a hand that may go in
_LOST = (0.060, 0.050, 0.12)  # the same of a hand that is not beside the lid any more
_LIFTED = 0.135  # height of the skirt's lower edge from where the lid passes over the box
_OVER_RIM = 0.10  # of the lid over its place, where its skirt passes over the box's rim
_OVER = (0.009, 0.06)  # beside the box's middle, and sine of the turn against it, from where it is lowered
_UNIT = 0.03  # metres: a gap that is felt as near
_CARRIED = (-0.020, 0.030)  # gaps of hands that carry a lid that is off the ground: a hand may lean, or bend a finger
_ABOUT = 0.025  # along the side and in height, from where hands hold it, within which they may lift
_SOFT = (-0.015, 0.008, 0.002)  # gaps of hands that press, from and to, and how softly
_AHEAD = 0.05  # radians by which palms may be ahead of the lid that they turn
_LEVER = 0.10  # metres: a turn as a distance


@dataclass(frozen=True)
class LiddedBox:
    """The entities, and when the lid is on the box."""

    lid: str = "lid"
    box: str = "box"
    beside: float = 0.013
    """Metres beside its place, at most."""
    over: float = 0.005
    """Metres over or under it, at most."""
    tilt: float = 0.012
    """Metres by which the lid's height is more than it is upright, at most."""


LIDDED_BOX = LiddedBox()
"""Of TwoArmBoxCleanup."""


@once
def _front(points: Points, name: str) -> Tensor:
    """Unit vector (B, 3, 1) along the sides that are held: nearest to the base's x axis."""
    ahead = torch.zeros_like(points[name][..., :1, :]).transpose(-1, -2)
    ahead[..., 0, 0] = 1.0
    return squared(points[name], ahead)


@once
def _middle(points: Points, name: str) -> Tensor:
    """Middle (B, 3) of a box's extents along its own sides."""
    front = _front(points, name)
    places = []
    for axis in (front, contacts.across(front)):
        values = along(points[name], axis)
        places.append(0.5 * (values.amin(-1) + values.amax(-1)).unsqueeze(-1) * axis.squeeze(-1))
    height = points[name][..., 2]
    flat = places[0] + places[1]
    return torch.cat([flat[..., :2], 0.5 * (height.amin(-1) + height.amax(-1)).unsqueeze(-1)], -1)


@once
def _from_grip(points: Points, lid: str, side: str) -> Tensor:
    """One hand's tool (B, 3) from where it holds the lid: along the side, out of it, up."""
    front = _front(points, lid)
    out = SIGN[side] * contacts.across(front)
    offset = hands.tool(points, side) - _middle(points, lid)
    parts = [(offset * axis.squeeze(-1)).sum(-1) for axis in (front, out)]
    return torch.stack([parts[0], parts[1] - LID_HALF[1] - FACE, offset[..., 2] - GRIP_HEIGHT], -1)


@once
def _gap(points: Points, lid: str, side: str) -> Tensor:
    """Gap (B,) between one hand and the lid's side; 1 m where it is not beside it."""
    along_side, gap, height = _from_grip(points, lid, side).unbind(-1)
    beside = (along_side.abs() <= LID_HALF[0]) & ((height + GRIP_HEIGHT).abs() <= BESIDE)
    return torch.where(beside, gap, 1.0)


def _gaps(points: Points, lid: str) -> Tensor:
    """Of both hands (B, 2)."""
    return torch.stack([_gap(points, lid, side) for side in SIDES], -1)


@once
def _way(points: Points, lidded: LiddedBox) -> Tensor:
    """The lid's way (B, 3) to its place on the box."""
    return _middle(points, lidded.box) - _middle(points, lidded.lid) + points[lidded.lid].new_tensor([0.0, 0.0, ON_BOX])


@once
def _turned(points: Points, lidded: LiddedBox) -> Tensor:
    """Sine (B,) of the angle between lid and box."""
    lid, box = _front(points, lidded.lid), _front(points, lidded.box)
    return (lid * contacts.across(box)).sum((-2, -1)).abs()


# Rules ------------------------------------------------------------------------------------------------------------


def held(lidded: LiddedBox, bounds: tuple[float, float] = PRESSED) -> Term:
    """Bool (B,): both hands press on the lid's sides, their gaps within ``bounds``, metres."""

    def term(points: Points, info: Info) -> Tensor:
        gaps = _gaps(points, lidded.lid)
        return ((gaps >= bounds[0]) & (gaps <= bounds[1])).all(-1)

    return term


def seated(lidded: LiddedBox) -> Term:
    """Bool (B,): the lid is on the box."""

    def term(points: Points, info: Info) -> Tensor:
        way, heights = _way(points, lidded), points[lidded.lid][..., 2]
        near = (way[..., :2].norm(dim=-1) <= lidded.beside) & (way[..., 2].abs() <= lidded.over)
        return near & (heights.amax(-1) - heights.amin(-1) <= 2 * LID_HALF[2] + lidded.tilt)

    return term


def released(lidded: LiddedBox, least: float) -> Term:
    """Bool (B,): both hands are ``least`` metres or more from the lid's sides."""
    return lambda points, info: _gaps(points, lidded.lid).amin(-1) >= least


# A simulator's shaped rewards -------------------------------------------------------------------------------------


def reach(lidded: LiddedBox) -> Term:
    """Nearness of both tools to where they hold the lid, up to 1."""

    def term(points: Points, info: Info) -> Tensor:
        distances = [_from_grip(points, lidded.lid, side).norm(dim=-1) for side in SIDES]
        return (1.0 - torch.tanh(5.0 * torch.stack(distances))).mean(0)

    return term


def brought(lidded: LiddedBox) -> Term:
    """Nearness of the lid to its place on the box."""
    return lambda points, info: 1.0 - torch.tanh(5.0 * _way(points, lidded).norm(dim=-1))


def apart(lidded: LiddedBox, whole: float) -> Term:
    """Gap of the nearer hand as a share of ``whole`` metres, up to 1."""
    return lambda points, info: (_gaps(points, lidded.lid).amin(-1) / whole).clamp(0.0, 1.0)


# The planners' stages ---------------------------------------------------------------------------------------------


def sequence(lidded: LiddedBox, least: float, limit: float) -> list[Stage]:
    """Go to both sides of the lid, lift it, carry it over the box, lower it, leave it by ``least`` metres, rest.

    Args:
        lidded: the box and its lid.
        least: gap of hands that have left the lid.
        limit: rad/s of arms that rest.
    """
    hold, rest, beside = held(lidded, _CARRIED), seated(lidded), _ready(lidded, _LOST)
    pressing = {
        "grip": (6.0, _off_grip(lidded)),
        "press": (6.0, _open(lidded)),
        "held": (-2.0, _firmness(lidded)),
        "squeeze": (2.0, _off_squeeze(lidded)),
    }
    carrying = {
        **pressing,
        "grip": (1.5, _off_grip(lidded)),
        "turn": (4.0, lambda p, i: _turned(p, lidded)),
        "way": (20.0, _way_onto(lidded)),
    }
    return [
        Stage(
            "surround",
            {"approach": (1.5, _approach(lidded)), "disturbance": (2.0, _disturbance(lidded))},
            _ready(lidded, _READY),
            lasting=lambda p, i: beside(p, i) | rest(p, i),
        ),
        Stage(
            "lift",
            {**pressing, "lift": (-5.0, _lift(lidded))},
            lambda p, i: hold(p, i) & (_skirt(p, lidded) >= _LIFTED),
        ),
        Stage("carry", carrying, lambda p, i: hold(p, i) & _is_over(p, lidded)),
        Stage("lower", carrying, rest),
        Stage("leave", {"apart": (-3.0, apart(lidded, 1.5 * least))}, released(lidded, least), lasting=rest),
        Stage("rest", {"speed": (2.0, hands.arm_speed)}, hands.static(limit)),
    ]


def heading(lidded: LiddedBox, side: str) -> Place:
    """Direction (B, 3) that a palm faces: the lid's side, a little ahead of the turn that brings the lid to the box."""

    def way(points: Points, info: Info) -> Tensor:
        front, wanted = (_front(points, name).squeeze(-1) for name in (lidded.lid, lidded.box))
        sine = front[..., 0] * wanted[..., 1] - front[..., 1] * wanted[..., 0]
        turn = sine.clamp(-_AHEAD, _AHEAD)
        along_lid = torch.stack([-front[..., 1], front[..., 0]], -1)
        ahead = front[..., :2] + turn.unsqueeze(-1) * along_lid  # small turns need no cosine
        inward = -SIGN[side] * torch.stack([-ahead[..., 1], ahead[..., 0], torch.zeros_like(turn)], -1)
        return torch.nn.functional.normalize(inward, dim=-1)

    return way


def _approach(lidded: LiddedBox) -> Term:
    """Ways of both tools to where they go in, sharper when near: high over the lid, outside it, then down."""

    def term(points: Points, info: Info) -> Tensor:
        total = torch.zeros_like(points[lidded.lid][..., 0, 0])
        for side in SIDES:
            along_side, gap, height = _from_grip(points, lidded.lid, side).unbind(-1)
            distance = way_from_above(torch.stack([along_side, gap - _OUTSIDE, height], -1), _CLEARANCE, within=0.02)
            inside = (0.02 - gap).clamp_min(0.0) * (height < LID_HALF[2])  # over the lid, or in it
            total = total + 5.0 * distance + torch.tanh(distance / 0.03) + 20.0 * inside
        return total

    return term


def _ready(lidded: LiddedBox, within: tuple[float, float, float]) -> Term:
    """Bool (B,): both hands are beside the lid or hold it, as near to where they hold it as ``within``, metres, says:
    along its side, in height and as a gap.
    """

    def term(points: Points, info: Info) -> Tensor:
        found = []
        for side in SIDES:
            along_side, gap, height = _from_grip(points, lidded.lid, side).unbind(-1)
            level = (along_side.abs() <= within[0]) & (height.abs() <= within[1])
            found.append(level & (gap <= within[2]) & (gap >= _CARRIED[0]))
        return torch.stack(found).all(0)

    return term


def _off_grip(lidded: LiddedBox) -> Term:
    """How far (B,) both hands are along the side and in height from where they hold the lid, in units of 3 cm."""

    def term(points: Points, info: Info) -> Tensor:
        offsets = [_from_grip(points, lidded.lid, side)[..., [0, 2]].norm(dim=-1) for side in SIDES]
        return torch.stack(offsets).sum(0) / _UNIT

    return term


def _open(lidded: LiddedBox) -> Term:
    """How far (B,) both hands are from the lid's sides, in units of 3 cm."""

    def term(points: Points, info: Info) -> Tensor:
        gaps = [_from_grip(points, lidded.lid, side)[..., 1] for side in SIDES]
        return (torch.stack(gaps).clamp_min(0.0) / _UNIT).clamp_max(5.0).sum(0)

    return term


def _off_squeeze(lidded: LiddedBox) -> Term:
    """By how much (B,) both hands are told to go inward less or more than a grip needs, as a share of that, up to 2."""

    def term(points: Points, info: Info) -> Tensor:
        out = contacts.across(_front(points, lidded.lid)).squeeze(-1)
        inward = [-SIGN[side] * (hands.command(info, side) * out).sum(-1) for side in SIDES]
        return (torch.stack(inward).mean(0) / SQUEEZE - 1.0).abs().clamp_max(2.0)

    return term


@once
def _pressing(points: Points, lid: str) -> Tensor:
    """Soft bool (B,): both hands press on the lid's sides, about where they hold it."""
    offsets = torch.stack([_from_grip(points, lid, side) for side in SIDES], 1)
    gaps, off = offsets[..., 1], offsets[..., [0, 2]].norm(dim=-1)
    pressed = torch.sigmoid((_SOFT[1] - gaps) / _SOFT[2]) * torch.sigmoid((gaps - _SOFT[0]) / _SOFT[2])
    return (pressed * torch.sigmoid((_ABOUT - off) / (0.2 * _ABOUT))).prod(-1)


def _firmness(lidded: LiddedBox) -> Term:
    return lambda points, info: _pressing(points, lidded.lid)


@once
def _skirt(points: Points, lidded: LiddedBox) -> Tensor:
    """Height (B,) of the lid's lowest point."""
    return points[lidded.lid][..., 2].amin(-1)


def _lift(lidded: LiddedBox) -> Term:
    """How high the held lid is, as a share of what it needs: up to 1."""

    def term(points: Points, info: Info) -> Tensor:
        return _pressing(points, lidded.lid) * (_skirt(points, lidded) / _LIFTED).clamp(0.0, 1.0)

    return term


def _way_onto(lidded: LiddedBox) -> Term:
    """Way (B,) of the lid onto the box, metres: up, over its place and down, sharper when near, a turn included."""

    def term(points: Points, info: Info) -> Tensor:
        offset = -_way(points, lidded)
        length = way_from_above(offset, _OVER_RIM, within=0.8 * _OVER[0], slope=0.02)
        beside = offset[..., :2].norm(dim=-1) + _LEVER * _turned(points, lidded)
        return length + 0.05 * torch.tanh(beside / 0.01)

    return term


def _is_over(points: Points, lidded: LiddedBox) -> Tensor:
    """Bool (B,): the lid is over its place."""
    near = _way(points, lidded)[..., :2].norm(dim=-1) <= _OVER[0]
    return near & (_turned(points, lidded) <= _OVER[1])


def _disturbance(lidded: LiddedBox) -> Term:
    """Speed (B,) of lid and box in units of 5 mm a step: something pushes them."""

    def term(points: Points, info: Info) -> Tensor:
        speeds = [speed(info["velocity"], name) for name in (lidded.lid, lidded.box)]
        return (torch.stack(speeds).sum(0) / 0.005).clamp_max(4.0)

    return term
