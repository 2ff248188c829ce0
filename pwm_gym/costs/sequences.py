"""Stages of long tasks for an arm with a parallel gripper, with parameters: a task is a sequence of them.

Lengths are in metres, angles in radians. Each stage ends by a rule of its own, most of which are also what a
simulator's reward or success asks for.

Example:
    >>> from pwm_gym.costs import drawers, sequences
    >>> stage = sequences.open_drawer(drawers.CABINET_DRAWER, 0.12)
    >>> stage.name
    'open drawer'
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from pwm_gym.costs import contacts, drawers, lids, objects
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.drawers import Drawer
from pwm_gym.costs.lids import Lid
from pwm_gym.costs.motion import joint_speed, speed
from pwm_gym.costs.registry import Function
from pwm_gym.costs.stages import Stage
from pwm_gym.costs.terms import Info, Place, Term, effort, ground_contact, tilt, tool, way_from_above
from pwm_gym.robots.speeds import JointSpeeds

__all__ = [
    "ALWAYS",
    "close_drawer",
    "close_lid",
    "insert",
    "leave",
    "open_drawer",
    "place",
    "put_in",
    "rest",
    "take",
    "take_out",
]

ALWAYS: Mapping[str, tuple[float, Function]] = {
    "ground_contact": (1.0, ground_contact),
    "effort": (1.0, effort),
    "tilt": (6.0, tilt),
}
"""Terms that count in every stage."""

_CLEAR = 0.07  # metres over a handle above which the fingers may be open, and turned in any way
_NARROW = 0.04  # metres between the fingers that are all too many there
_SLOW = 0.003  # metres a step of an object that has been let go, and stands
_WIDE = 0.075  # metres between open fingers
_TURNED, _ILL_TURNED = 0.06, 0.17  # shares of a right angle that the fingers may be off, and that are all wrong
_MOVED = 8.0  # weight of the whole way of a drawer or a lid
_BLOCKED = 3.0  # weight of a hand that would be in a cabinet
_SPARE = 0.02  # metres by which a drawer is opened farther: it is pushed back a little where the hand leaves it


def open_drawer(drawer: Drawer, least: float) -> Stage:
    """Hook shut fingers behind the handle's bar from above, and pull until the drawer is open by ``least`` and a bit.

    Hooked, the hand needs no turn and no width of its fingers to a millimetre, as it would to grasp the bar.
    """
    behind, turn = drawers.behind_handle(drawer), drawers.along_handle(drawer)
    return Stage(
        f"open {drawer.name}",
        {
            "approach": (1.5, _approach(behind, clearance=0.05)),
            "misalignment": (3.0, turn),
            "loose": (1.0, _open),
            "finger_blocking": (3.0, _low_unready(behind, turn)),
            "opened": (-_MOVED, drawers.opened(drawer)),
        },
        drawers.open_to(drawer, least + _SPARE),
    )


def close_drawer(drawer: Drawer, most: float) -> Stage:
    """Go before the handle, and push until the drawer is open by ``most`` at most."""
    shut = drawers.shut_to(drawer, most)
    return Stage(
        f"close {drawer.name}",
        {
            "approach": (1.5, _approach(drawers.before_handle(drawer), clearance=0.05)),
            "opened": (_MOVED, drawers.opened(drawer)),
        },
        shut,
        lasting=shut,
    )


def take(name: str, height: float, until: Term | None = None) -> Stage:
    """Hold an object, and lift it until all of it is ``height`` over the ground.

    Args:
        name: the object.
        height: of its lowest point.
        until: rule that ends the stage, too: the object is where it belongs already.
    """
    held = objects.held(name)

    def lifted(points: Points, info: Info) -> Tensor:
        over = held(points, info) & (points[name][..., 2].amin(-1) >= height)
        return over if until is None else over | until(points, info)

    return Stage(f"take {name}", {**_grasp(name), "lift": (-5.0, objects.lift(name, height))}, lifted)


def take_out(name: str, drawer: Drawer, height: float, until: Term | None = None) -> Stage:
    """As :func:`take`, out of an open drawer: the hand is turned along its handle, so that it passes by the cabinet."""
    way = objects.way_to_grip(name)
    return take(name, height, until).plus(
        {
            "turn": (2.0, drawers.along_handle(drawer)),
            "hand_blocking": (_BLOCKED, drawers.hand_blocking(drawer, way)),
            "tray_blocking": (_BLOCKED, drawers.fingers_blocking(drawer, way)),
        }
    )


def place(name: str, onto: str, target: Place, arrived: Term, clearance: float = 0.02) -> Stage:
    """Hold an object, carry it from above to a place, and let it go.

    Args:
        name: the object.
        onto: what the place belongs to, for the stage's name.
        target: where the mean of its points shall be.
        arrived: rule that it is there, from then on; the stage ends when it is not held any more, and stands.
        clearance: height over the place at which it is carried.
    """
    held = objects.held(name)

    def done(points: Points, info: Info) -> Tensor:
        slow = speed(info["velocity"], name) <= _SLOW
        return arrived(points, info) & ~held(points, info) & slow

    terms = {**_grasp(name), "carry": (-2.0, objects.carry_onto(name, target, clearance))}
    return Stage(f"place {name} at {onto}", {**terms, "hold_on": (2.0, _both(arrived, held))}, done, lasting=arrived)


def leave(name: str) -> Stage:
    """Raise the open fingers off an object that has been let go, until they may go anywhere without pushing it."""
    return Stage(
        f"leave {name}",
        {
            "low": (8.0, objects.hand_low(name)),
            "narrow": (2.0, _narrow),
            "disturbance": (2.0, objects.disturbance(name)),
        },
        objects.hand_clear(name),
    )


def put_in(name: str, drawer: Drawer, inside: Term) -> Stage:
    """Put an object into an open drawer, until the rule ``inside`` says that it is there."""
    target = drawers.spot(drawer, name)

    def way(points: Points, info: Info) -> Tensor:
        return target(points, info) - contacts.centre(points, name)

    stage = place(name, drawer.name, target, inside, clearance=0.08)
    return stage.plus({"hand_blocking": (_BLOCKED, drawers.hand_blocking(drawer, way))})


def insert(name: str, lid: Lid, seated: Term) -> Stage:
    """Drop an object into a machine's holder, until the rule ``seated`` says that it is there.

    The holder is hardly wider than the object, which therefore comes down exactly on its axis.
    """
    target = lids.holder(lid)
    stage = place(name, lid.machine, target, seated)
    carry = objects.carry_onto(name, target, clearance=0.065, within=0.002, slope=0.008)
    return stage.plus({"carry": (-2.0, carry), "aligned": (-1.5, objects.aligned(name, target))})


def close_lid(lid: Lid, most: float) -> Stage:
    """Push a standing lid over from behind, until it is open by ``most`` at most."""
    closed = lids.shut_to(lid, most)
    return Stage(
        f"close {lid.name}",
        {"approach": (1.5, _approach(lids.behind(lid), clearance=0.09)), "shut": (-_MOVED, lids.shut(lid))},
        closed,
        lasting=closed,
    )


def rest(arm: JointSpeeds, limit: float) -> Stage:
    """Stand still, until no joint of the arm is faster than ``limit`` rad/s."""
    return Stage(
        "rest",
        {"moving": (1.0, lambda points, info: (joint_speed(points, info, arm) / limit).clamp_max(3.0))},
        lambda points, info: joint_speed(points, info, arm) <= limit,
    )


def _grasp(name: str) -> dict[str, tuple[float, Function]]:
    """Terms of a grasp from above anywhere on an object."""
    return {
        "approach": (1.5, objects.approach(name, clearance=0.05)),
        "premature_close": (4.0, objects.premature_close(name)),
        "finger_blocking": (3.0, objects.finger_blocking(name)),
        "misalignment": (2.0, objects.misalignment(name)),
        "disturbance": (0.5, objects.disturbance(name)),
    }


def _approach(target: Place, clearance: float) -> Term:
    """Way of the tool to a place from above, sharper when near."""

    def term(points: Points, info: Info) -> Tensor:
        way = way_from_above(tool(points, info) - target(points, info), clearance)
        return 5.0 * way + torch.tanh(way / 0.02)

    return term


def _open(points: Points, info: Info) -> Tensor:
    """How far the fingers are open: 1 where they could not hook a handle."""
    return (contacts.opening(points) / _NARROW).clamp(0.0, 1.0)


def _narrow(points: Points, info: Info) -> Tensor:
    """How far the fingers are from being open, as a share of the way."""
    return (1.0 - contacts.opening(points) / _WIDE).clamp(0.0, 1.0)


def _low_unready(target: Place, turn: Term) -> Term:
    """How far the tool is below 7 cm over a place, as a share of them, while the fingers are open or ill turned."""

    def term(points: Points, info: Info) -> Tensor:
        height = contacts.tool_centre(points)[..., 2] - target(points, info)[..., 2]
        low = (1.0 - height / _CLEAR).clamp(0.0, 1.0)
        ill_turned = ((turn(points, info) - _TURNED) / (_ILL_TURNED - _TURNED)).clamp(0.0, 1.0)
        return low * torch.maximum(_open(points, info), ill_turned)

    return term


def _both(first: Term, second: Term) -> Term:
    """1 where both rules hold."""
    return lambda points, info: (first(points, info) & second(points, info)).float()
