"""Shared terms for a drawer in its cabinet, told from the extents of their clouds; used as :mod:`.terms` is.

Cabinet and drawer are each the same to the left and to the right, and stand upright. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points, across, along, level, once, squared
from pwm_gym.costs.terms import Info, Place, Term, centre, nearness, tool
from pwm_gym.sim.cabinets import LOW_CABINET, Cabinet

__all__ = [
    "CABINET_DRAWER",
    "Drawer",
    "along_handle",
    "before_handle",
    "behind_handle",
    "fingers_blocking",
    "front",
    "hand_blocking",
    "handle",
    "inside",
    "open_to",
    "opened",
    "opening",
    "put_in",
    "reach",
    "shut_to",
    "spot",
]

_FINGER_GAP, _FINGER_DEEP = 0.004, 0.01  # metres between finger and side, and of the finger in it that count as 1
_HAND_DEEP = 0.03  # metres of the hand in the cabinet that count as 1


@dataclass(frozen=True)
class Drawer:
    """Where the parts of a drawer are, from the foremost, lowest and highest of its points."""

    way: float
    """How far it opens."""
    ahead: float
    """Distance from the middle of the cabinet's extent along the way to that of the drawer's, when it is shut."""
    bar: tuple[float, float]
    """The middle of its handle's bar: behind the foremost point, and below the highest."""
    tray: tuple[float, float, float]
    """Front and back of the tray's inside behind the foremost point, and half its width."""
    floor: float
    """Height of the tray's floor over the lowest point."""
    place: float
    """Where things are put: behind the foremost point."""
    name: str = "drawer"
    cabinet: str = "cabinet"
    aside: float = 0.0
    """The bar's middle beside that of the drawer, to the left of the way in which it opens."""
    place_aside: float = 0.0
    """The same of the place."""

    @classmethod
    def of(cls, cabinet: Cabinet) -> Drawer:
        """The drawer of a cabinet whose entities are called ``cabinet`` and ``drawer``."""
        low, high, tray = cabinet.drawer_from, cabinet.drawer_to, cabinet.tray
        return cls(
            way=cabinet.stroke,
            ahead=0.5 * (low[0] + high[0]),
            bar=(high[0] - cabinet.handle[0], high[2] - cabinet.handle[2]),
            tray=(high[0] - tray[1][0], high[0] - tray[0][0], tray[1][1]),
            floor=cabinet.tray_floor - low[2],
            place=high[0] - cabinet.place[0],
            aside=cabinet.handle[1],
            place_aside=cabinet.place[1],
        )


CABINET_DRAWER = Drawer.of(LOW_CABINET)
"""Of the low cabinet."""


@once
def _front(points: Points, drawer: Drawer) -> Tensor:
    """Unit vector (B, 3, 1) in which it opens."""
    way = contacts.centre(points, drawer.name) - contacts.centre(points, drawer.cabinet)
    return squared(points[drawer.cabinet], level(way))


def front(points: Points, drawer: Drawer) -> Tensor:
    """Horizontal unit vector (B, 3, 1) in which it opens."""
    return _front(points, drawer)


@once
def _side(points: Points, drawer: Drawer) -> Tensor:
    """Horizontal unit vector (B, 3, 1) across it."""
    return across(_front(points, drawer))


def _extent(points: Points, name: str, axis: Tensor) -> tuple[Tensor, Tensor]:
    """Least and greatest coordinate (B,) of an entity along an axis (B, 3, 1)."""
    places = along(points[name], axis)
    return places.amin(-1), places.amax(-1)


@once
def opening(points: Points, drawer: Drawer) -> Tensor:
    """How far (B,) it is open."""
    axis = _front(points, drawer)
    back, front = _extent(points, drawer.name, axis)
    wall, edge = _extent(points, drawer.cabinet, axis)
    return 0.5 * (back + front - wall - edge) - drawer.ahead


@once
def _point(points: Points, drawer: Drawer, behind: float, aside: float = 0.0) -> Tensor:
    """Place (B, 3) at height 0, ``behind`` its foremost point and ``aside`` of the middle of its width, to the left."""
    front, side = _front(points, drawer), _side(points, drawer)
    foremost = _extent(points, drawer.name, front)[1]
    left, right = _extent(points, drawer.name, side)
    across_way = 0.5 * (left + right) + aside
    return (front * (foremost - behind)[..., None, None] + side * across_way[..., None, None]).squeeze(-1)


def handle(drawer: Drawer) -> Place:
    """Middle of the handle's bar."""
    return before_handle(drawer, gap=0.0)


def before_handle(drawer: Drawer, gap: float = 0.022) -> Place:
    """Place at the handle's height, ``gap`` metres before its bar: from where fingers push it."""

    def place(points: Points, info: Info) -> Tensor:
        flat = _point(points, drawer, drawer.bar[0] - gap, drawer.aside)
        return torch.cat([flat[..., :2], points[drawer.name][..., 2:].amax(-2) - drawer.bar[1]], -1)

    return place


def behind_handle(drawer: Drawer, gap: float = 0.024) -> Place:
    """Place at the handle's height, ``gap`` metres behind its bar: from where fingers pull it."""
    return before_handle(drawer, -gap)


def spot(drawer: Drawer, name: str) -> Place:
    """Where an object's centre is when it stands in its place in the drawer."""

    def place(points: Points, info: Info) -> Tensor:
        flat = _point(points, drawer, drawer.place, drawer.place_aside)
        height = contacts.centre(points, name)[..., 2] - points[name][..., 2].amin(-1)
        floor = points[drawer.name][..., 2].amin(-1) + drawer.floor
        return torch.cat([flat[..., :2], (floor + height).unsqueeze(-1)], -1)

    return place


def hand_blocking(drawer: Drawer, way: Place) -> Term:
    """How deep (B,) the hand, turned as it is, would be in the cabinet at the end of a way: 1 at 3 cm or more.

    Args:
        drawer: of the cabinet.
        way: that the hand has still to go (B, 3), metres.
    """

    def term(points: Points, info: Info) -> Tensor:
        hand, front = points["hand"] + way(points, info).unsqueeze(-2), _front(points, drawer)
        low = hand[..., 2] < points[drawer.cabinet][..., 2].amax(-1, keepdim=True)
        depth = _extent(points, drawer.cabinet, front)[1].unsqueeze(-1) - along(hand, front)
        return ((depth * low).amax(-1) / _HAND_DEEP).clamp(0.0, 1.0)

    return term


def fingers_blocking(drawer: Drawer, way: Place) -> Term:
    """How far (B,) a finger, open as it is, would be in a side of the tray at the end of a way: 1 at 1 cm or more.

    Args:
        drawer: of the tray.
        way: that the hand has still to go (B, 3), metres.
    """
    half_width = drawer.tray[2]

    def term(points: Points, info: Info) -> Tensor:
        moved = way(points, info) - _point(points, drawer, 0.0)
        fingers = torch.cat([points["left_gripper"], points["right_gripper"]], -2) + moved.unsqueeze(-2)
        beside = along(fingers, _side(points, drawer)).abs().amax(-1)
        return ((beside + _FINGER_GAP - half_width) / _FINGER_DEEP).clamp(0.0, 1.0)

    return term


# Rules ------------------------------------------------------------------------------------------------------------


def open_to(drawer: Drawer, least: float) -> Term:
    """Bool (B,): it is open by ``least`` metres or more."""
    return lambda points, info: opening(points, drawer) >= least


def shut_to(drawer: Drawer, most: float) -> Term:
    """Bool (B,): it is open by ``most`` metres at most."""
    return lambda points, info: opening(points, drawer) <= most


def inside(drawer: Drawer, name: str, edge: float, height: float) -> Term:
    """Bool (B,): an object is in its tray.

    Args:
        drawer: that it is in.
        name: the object.
        edge: metres from the tray's walls to the object's centre, at the least.
        height: metres from the tray's floor to the object's lowest point, at the most.
    """
    front, back, half_width = drawer.tray

    def term(points: Points, info: Info) -> Tensor:
        axes = torch.cat([_front(points, drawer), _side(points, drawer)], -1)  # (B, 3, 2)
        offset = contacts.centre(points, name) - _point(points, drawer, 0.0)
        before, aside = (offset.unsqueeze(-2) @ axes).squeeze(-2).unbind(-1)
        within = (-before >= front + edge) & (-before <= back - edge) & (aside.abs() <= half_width - edge)
        floor = points[drawer.name][..., 2].amin(-1) + drawer.floor
        return within & (points[name][..., 2].amin(-1) - floor <= height)

    return term


# A simulator's shaped rewards -------------------------------------------------------------------------------------


def opened(drawer: Drawer) -> Term:
    """Share of its way by which it is open."""
    return lambda points, info: (opening(points, drawer) / drawer.way).clamp(0.0, 1.0)


def reach(target: Place) -> Term:
    """Nearness of the tool to a place."""
    return nearness(tool, target)


def along_handle(drawer: Drawer) -> Term:
    """Angle of the line through both fingers from the handle's bar, as a share of a right one: 0 along it, 1 across."""

    def term(points: Points, info: Info) -> Tensor:
        along_bar = (contacts.fingers_axis(points) * _side(points, drawer)).sum((-2, -1)).abs()
        return torch.acos(along_bar.clamp_max(1.0 - 1e-6)) / (0.5 * pi)

    return term


def put_in(drawer: Drawer, name: str) -> Term:
    """Nearness of an object to its place in the drawer."""
    return nearness(centre(name), spot(drawer, name))
