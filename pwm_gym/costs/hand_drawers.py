"""Shared terms and stages for two hands and a drawer: one opens and shuts it, the other brings an object. Metres.

The object is held between the straight fingers of a hand and its thumb, which swings opposite to them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pwm_gym.costs import contacts, drawers, hands
from pwm_gym.costs.contacts import Points, along, once
from pwm_gym.costs.drawers import Drawer
from pwm_gym.costs.motion import speed
from pwm_gym.costs.stages import Stage
from pwm_gym.costs.terms import Info, Place, Term, nearness, way_from_above
from pwm_gym.robots.two_hands import AMID, FACE, HELD, HOLDING, SIGN
from pwm_gym.sim.cabinets import DEEP_CABINET

__all__ = ["DEEP_DRAWER", "beside", "heading", "held", "holds", "reach", "reach_handle", "sequence"]

DEEP_DRAWER = Drawer.of(DEEP_CABINET)
"""Of TwoArmDrawerCleanup."""

_GAP_MIDDLE = DEEP_CABINET.handle[0] - DEEP_CABINET.gap_middle  # behind the bar, where a hand hangs
_BAR_OVER = 0.006  # of the tool over the bar there
_HUNG = (0.022, 0.030, 0.015)  # along the way, across it, in height: the hand is behind the bar
_AT_BAR = (0.045, 0.050, 0.035)  # the same of one that may have slipped, but is not off the handle yet
_HIGH = 0.10  # of a hand over where it goes, while it turns or waits
_OVER_BAR = (0.03, 0.06)  # beside where the hand hangs, at most, and over it, at least, of one that may come down
_TURNED = 0.02  # share of a half turn, at most, by which a hand may be turned that comes down
_OPENED_FURTHER = 0.025
_CLEARANCE, _GRIP_HEIGHT = 0.08, 0.018
# Beside its place, within which a hand comes down, and farther out, where its finger tips pass over what is there:
_IN_GAP, _ABOUT_OBJECT = (0.020, 0.020), (0.008, 0.015)
_ABOUT = (0.009, 0.010)  # beside and over its place, of a hand that may close
_SLIPPED = 0.06  # from where the hand closes about an object, of one that it has lost
_PRESS = 0.5 * (HOLDING[1] + 1.0)  # how far the thumb is told to bend that holds an object, 0 straight to 1
_SWUNG = 0.076  # from the fingers' face to the thumb opposite to it
_LIFTED, _CARRIED = 0.06, 0.13  # of an object's lowest point over the ground, and over the tray's floor
_OFF_GROUND, _OVER_PLACE = 0.02, 0.015
_LEFT = 0.16  # of the tool over the middle of an object that it has left: the cabinet passes under it
_UNIT = 0.03


@once
def _along_normal(points: Points, side: str, name: str) -> tuple[Tensor, Tensor]:
    """Gaps (B,) between an object and a hand's fingers, and its thumb, along the way out of the palm."""
    normal = hands.normal(points, side).unsqueeze(-1)
    places = along(points[name], normal)
    fingers = along(hands.tool(points, side).unsqueeze(-2), normal).squeeze(-1) + FACE
    thumb = along(points[f"{side}_thumb_2"], normal).amin(-1)
    return places.amin(-1) - fingers, thumb - places.amax(-1)


def holds(side: str, name: str) -> Term:
    """Bool (B,): fingers and thumb of a hand touch an object between them."""

    def term(points: Points, info: Info) -> Tensor:
        gaps = torch.stack(_along_normal(points, side, name), -1)
        low, high = gaps.new_tensor(HELD).unbind(-1)
        touching = ((gaps >= low) & (gaps <= high)).all(-1)
        offset = contacts.centre(points, name) - hands.tool(points, side)
        aside = (offset * hands.across(points, side)).sum(-1).abs()
        return touching & (aside <= AMID[0]) & (offset[..., 2].abs() <= AMID[1])

    return term


def held(name: str) -> Term:
    """Bool (B,): one of both hands holds an object."""
    left, right = holds("left", name), holds("right", name)
    return lambda points, info: left(points, info) | right(points, info)


def reach(side: str, name: str) -> Term:
    """Nearness of one hand's tool to an object."""
    return nearness(hands.tool_place(side), lambda points, info: contacts.centre(points, name))


def reach_handle(side: str, drawer: Drawer) -> Term:
    """Nearness of one hand's tool to the middle of the handle's bar."""
    return nearness(hands.tool_place(side), drawers.handle(drawer))


def heading(side: str, drawer: Drawer) -> Place:
    """Direction (B, 3) that a palm faces: the left one the way in which a drawer opens, the right one across it."""

    def way(points: Points, info: Info) -> Tensor:
        front = drawers.front(points, drawer)
        return (front if side == "left" else SIGN[side] * contacts.across(front)).squeeze(-1)

    return way


def _facing(side: str, drawer: Drawer) -> Term:
    """How far (B,) a palm is turned from there: 0 to 1."""
    wanted = heading(side, drawer)
    return lambda points, info: 0.5 * (1.0 - (hands.normal(points, side) * wanted(points, info)).sum(-1))


def beside(side: str, drawer: Drawer) -> Place:
    """Way (B, 3) from one hand's tool to where it hangs behind the handle's bar: along the drawer's way, across, up."""
    hang = drawers.behind_handle(drawer, _GAP_MIDDLE)

    def place(points: Points, info: Info) -> Tensor:
        offset = hang(points, info) - hands.tool(points, side)
        front = drawers.front(points, drawer)
        parts = [(offset * axis.squeeze(-1)).sum(-1) for axis in (front, contacts.across(front))]
        return torch.stack([*parts, offset[..., 2] + _BAR_OVER], -1)

    return place


# The planners' stages ---------------------------------------------------------------------------------------------


def sequence(drawer: Drawer, name: str, inside: Term, opened: float, shut: float, limit: float) -> list[Stage]:
    """The left hand opens the drawer, the right one puts an object into it, the left one shuts it, both rest.

    Args:
        drawer: the drawer.
        name: the object.
        inside: rule that it is in the drawer.
        opened: way from which the drawer counts as open.
        shut: way up to which it counts as shut.
        limit: rad/s of arms that rest.
    """
    is_held, is_shut = holds("right", name), drawers.shut_to(drawer, shut)
    still_open, is_open = drawers.open_to(drawer, opened), drawers.open_to(drawer, opened + _OPENED_FURTHER)
    hooked = _hangs(drawer, _AT_BAR)

    def raised(points: Points, height: float) -> Tensor:
        return points[name][..., 2].amin(-1) >= height

    def over_place(points: Points, info: Info) -> Tensor:
        carried = is_held(points, info) & still_open(points, info)
        return carried & (_beside_place(points, info, drawer, name) <= _OVER_PLACE)

    hang: dict[str, tuple[float, Term]] = {"hang": (5.0, _off(beside("left", drawer)))}
    unbent = {"thumb": (4.0, hands.bent_thumb("right"))}
    waiting: dict[str, tuple[float, Term]] = {**unbent, "wait": (0.5, _over(_way_to_grip(name)))}
    pressing = {"thumb": (2.0, _off_press)}
    gripping = {**hang, **pressing, "closed": (3.0, _open_hand(name)), "off_grip": (4.0, _off_grip(name))}
    above = {"low": (10.0, _too_low(name))}
    disturbed = {"disturbance": (2.0, lambda p, i: (speed(i["velocity"], name) / 0.005).clamp_max(4.0))}
    return [
        Stage("turn", {**waiting, **disturbed, "over": (2.0, _over(beside("left", drawer)))}, _may_hang(drawer)),
        Stage(
            "hook",
            {**waiting, **disturbed, "approach": (2.0, _from_above(beside("left", drawer), *_IN_GAP))},
            _hangs(drawer),
            lasting=lambda p, i: hooked(p, i) | is_shut(p, i) | (still_open(p, i) & ~inside(p, i)),
        ),
        Stage(
            "open drawer",
            {**waiting, "hang": (3.0, _level(beside("left", drawer))), "opened": (-8.0, drawers.opened(drawer))},
            lambda p, i: is_open(p, i) | inside(p, i),
            lasting=lambda p, i: still_open(p, i) | inside(p, i),
        ),
        Stage(
            "reach",
            {**hang, **unbent, **disturbed, "approach": (2.0, _from_above(_way_to_grip(name), *_ABOUT_OBJECT))},
            lambda p, i: _about(p, i, name) | (is_held(p, i) & raised(p, _OFF_GROUND)) | inside(p, i),
            lasting=lambda p, i: _at_hand(p, i, name) | inside(p, i),
        ),
        Stage(
            "take",
            {**gripping, "lift": (-5.0, _lift(name))},
            lambda p, i: (is_held(p, i) & raised(p, _LIFTED)) | inside(p, i),
        ),
        Stage(
            "carry",
            {**gripping, "way": (4.0, _way_over(drawer, name))},
            lambda p, i: over_place(p, i) | inside(p, i),
        ),
        Stage("lower", {**gripping, "way": (4.0, _way_down(drawer, name))}, inside),
        Stage(
            "let go",
            {**hang, **disturbed, **above, **unbent},
            lambda p, i: ~is_held(p, i) & (_too_low(name)(p, i) <= 0.0),
            lasting=inside,
        ),
        Stage(
            "close drawer",
            {**above, "hang": (3.0, _level(beside("left", drawer))), "opened": (8.0, drawers.opened(drawer))},
            is_shut,
            lasting=is_shut,
        ),
        Stage("rest", {"speed": (2.0, hands.arm_speed)}, hands.static(limit)),
    ]


def _off(way: Place) -> Term:
    """Length (B,) of a way, sharper when near."""
    return lambda points, info: _felt(way(points, info).norm(dim=-1), 3.0)


def _felt(distance: Tensor, slope: float) -> Tensor:
    """A distance (B,), metres, as a cost that is sharper when near, and ``slope`` a metre when far."""
    return slope * distance + torch.tanh(distance / _UNIT)


def _level(way: Place) -> Term:
    """The same without what is along the drawer's way, in which the hand pulls and pushes."""
    return _off(lambda points, info: way(points, info)[..., 1:])


def _from_above(way: Place, within: float, slope: float) -> Term:
    """Length (B,) of a way that comes from above, sharper when near."""

    def term(points: Points, info: Info) -> Tensor:
        return _felt(way_from_above(-way(points, info), _CLEARANCE, within, slope), 5.0)

    return term


def _over(way: Place) -> Term:
    """Length (B,) of a way to 10 cm over its end, sharper when near."""

    def term(points: Points, info: Info) -> Tensor:
        whole = way(points, info)
        return _felt((whole + whole.new_tensor([0.0, 0.0, _HIGH])).norm(dim=-1), 5.0)

    return term


def _may_hang(drawer: Drawer) -> Term:
    """Bool (B,): the left hand is over the gap behind the bar and turned as it hangs there, or hangs there."""
    way, hangs = beside("left", drawer), _hangs(drawer)

    def term(points: Points, info: Info) -> Tensor:
        offset = way(points, info)
        over = (offset[..., :2].norm(dim=-1) <= _OVER_BAR[0]) & (-offset[..., 2] >= _OVER_BAR[1])
        return (over & (_facing("left", drawer)(points, info) <= _TURNED)) | hangs(points, info)

    return term


def _hangs(drawer: Drawer, within: tuple[float, float, float] = _HUNG) -> Term:
    """Bool (B,): the left hand is behind the bar, or as near to there as ``within``, metres, says."""
    way = beside("left", drawer)

    def term(points: Points, info: Info) -> Tensor:
        offset = way(points, info).abs()
        return (offset <= offset.new_tensor(within)).all(-1) & (_facing("left", drawer)(points, info) <= _TURNED)

    return term


def _way_to_grip(name: str) -> Place:
    """Way (B, 3) of the right tool to where it closes about an object."""

    def place(points: Points, info: Info) -> Tensor:
        normal = hands.normal(points, "right")
        offset = contacts.centre(points, name) - hands.tool(points, "right")
        amid = offset - (FACE + 0.5 * _SWUNG) * normal
        return torch.cat([amid[..., :2], offset[..., 2:] + _GRIP_HEIGHT], -1)

    return place


def _about(points: Points, info: Info, name: str) -> Tensor:
    """Bool (B,): the right hand may close about an object."""
    way = _way_to_grip(name)(points, info)
    fingers, thumb = _along_normal(points, "right", name)
    amid = (way[..., :2].norm(dim=-1) <= _ABOUT[0]) & (way[..., 2].abs() <= _ABOUT[1])
    return amid & (fingers >= -0.002) & (thumb >= -0.002)


def _at_hand(points: Points, info: Info, name: str) -> Tensor:
    """Bool (B,): the object has not slipped from the right hand."""
    return _way_to_grip(name)(points, info).norm(dim=-1) <= _SLIPPED


def _open_hand(name: str) -> Term:
    """Gaps (B,) of the right hand to an object, in units of 3 cm."""

    def term(points: Points, info: Info) -> Tensor:
        gaps = torch.stack(_along_normal(points, "right", name))
        return (gaps.clamp_min(0.0) / _UNIT).clamp_max(5.0).sum(0)

    return term


def _off_grip(name: str) -> Term:
    """How far (B,) the right hand is beside and over where it holds an object, in units of 3 cm."""

    def term(points: Points, info: Info) -> Tensor:
        offset = contacts.centre(points, name) - hands.tool(points, "right")
        aside = (offset * hands.across(points, "right")).sum(-1)
        return torch.stack([aside, offset[..., 2] + _GRIP_HEIGHT], -1).norm(dim=-1) / _UNIT

    return term


def _off_press(points: Points, info: Info) -> Tensor:
    """How far (B,) the right thumb is told to bend more or less than holds an object."""
    return (hands.bent_thumb("right")(points, info) - _PRESS).abs()


@once
def _firmness(points: Points, name: str) -> Tensor:
    """Soft bool (B,): fingers and thumb of the right hand touch an object."""
    gaps = torch.stack(_along_normal(points, "right", name), -1)
    return (torch.sigmoid((0.004 - gaps) / 0.001) * torch.sigmoid((gaps - HELD[0][0]) / 0.001)).prod(-1)


def _lift(name: str) -> Term:
    """How high the held object is, as a share of 6 cm: up to 1."""
    return lambda points, info: _firmness(points, name) * (points[name][..., 2].amin(-1) / _LIFTED).clamp(0.0, 1.0)


def _to_place(points: Points, info: Info, drawer: Drawer, name: str) -> Tensor:
    """Way (B, 3) of an object to its place in the drawer."""
    return drawers.spot(drawer, name)(points, info) - contacts.centre(points, name)


def _beside_place(points: Points, info: Info, drawer: Drawer, name: str) -> Tensor:
    """How far (B,) an object is beside its place."""
    return _to_place(points, info, drawer, name)[..., :2].norm(dim=-1)


def _way_over(drawer: Drawer, name: str) -> Term:
    """Way (B,) of an object to over its place."""

    def term(points: Points, info: Info) -> Tensor:
        way = _to_place(points, info, drawer, name)
        lower = (_CARRIED + way[..., 2]).clamp_min(0.0)
        return _felt(way[..., :2].norm(dim=-1) + 2.0 * lower, 3.0)

    return term


def _way_down(drawer: Drawer, name: str) -> Term:
    """Way (B,) of an object to its place, sharper when near."""
    return _off(lambda points, info: _to_place(points, info, drawer, name))


def _too_low(name: str) -> Term:
    """By how much (B,) the right tool is lower than 16 cm over the middle of an object that it has left."""

    def term(points: Points, info: Info) -> Tensor:
        height = hands.tool(points, "right")[..., 2] - contacts.centre(points, name)[..., 2]
        return (_LEFT - height).clamp_min(0.0)

    return term
