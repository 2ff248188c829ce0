"""Terms of planners' costs that push an object over a table to its goal, used as :mod:`.terms` are."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.costs import contacts, shaped, terms
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.terms import Info, Term
from pwm_gym.robots.gripper import Gripper

__all__ = ["Slide", "behind", "goal_distance", "pressing", "pushed_terms", "pushing_terms", "wrong_side"]

_NEAR = 0.02  # metres from the goal within which the way there counts most
_LEVEL = 0.03  # metres over an object's centre above which the tool is clear of it
_SLACK = 0.005  # metres over it up to which the tool pushes
_CLEAR = 0.065  # metres over it from which the tool does not touch it, unless a task says otherwise
_REACH = 0.02  # metres farther than where it pushes that the tool still presses


@dataclass(frozen=True)
class Slide:
    """How friction slows an object down, which may take more from what is fast: metres a step, each step."""

    slow: float
    """Of what is slower than :attr:`fast_from`."""
    fast: float
    """Of what is faster."""
    fast_from: float = 0.0
    """Metres a step."""

    def way(self, speed: Tensor) -> Tensor:
        """Metres (...) to go after steps of ``speed`` (...) metres."""
        below = speed.clamp(max=self.fast_from)
        above = (speed.square() - below.square()) / (2.0 * self.fast)
        return (below.square() / (2.0 * self.slow) + above - 0.5 * speed).clamp_min(0.0)


def pushed_terms(name: str, gripper: Gripper, success: Term) -> dict[str, tuple[float, Term]]:
    """Weighted terms of minus a dense reward: the tool near the object, and thrice that near its goal; -1 at success.

    Args:
        name: the object.
        gripper: that pushes.
        success: the success rule.
    """
    reach = terms.reach(name, gripper)
    place = terms.nearness(terms.centre(name), terms.goal_position)

    def pushing(points: Points, info: Info) -> Tensor:
        return reach(points, info) + 3.0 * place(points, info)

    return shaped.normalised(4.0, {"pushing": (None, 0.0, pushing)}, success)


def goal_distance(name: str, slide: Slide | None = None) -> Term:
    """Distance (B,) in the plane from where an object comes to rest to the goal, sharper when near.

    Args:
        name: the object.
        slide: how friction slows it down; None: it stops at once.
    """

    def term(points: Points, info: Info) -> Tensor:
        place = contacts.centre(points, name)
        if slide is not None:
            step = info["velocity"][name].mean(-2)
            speed = step.norm(dim=-1, keepdim=True)
            place = place + step / speed.clamp_min(1e-9) * slide.way(speed)
        way = (place - info["goal"])[..., :2].norm(dim=-1)
        return 5.0 * way + torch.tanh(way / _NEAR)

    return term


def behind(name: str, gripper: Gripper, contact: float) -> Term:
    """Distance (B,) from the tool to where it pushes the object towards the goal.

    Args:
        name: the object.
        gripper: that pushes.
        contact: distance, metres, of the tool from the object's centre there.
    """

    def term(points: Points, info: Info) -> Tensor:
        centre = contacts.centre(points, name)
        way = (info["goal"] - centre) * centre.new_tensor([1.0, 1.0, 0.0])
        ahead = way / way.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        return (contacts.tool_centre(points, gripper) - (centre - contact * ahead)).norm(dim=-1)

    return term


def wrong_side(name: str, gripper: Gripper, contact: float) -> Term:
    """How far (B,) a low tool is before the object rather than behind it, metres: it would push it away."""

    def term(points: Points, info: Info) -> Tensor:
        centre, tool = contacts.centre(points, name), contacts.tool_centre(points, gripper)
        way = (info["goal"] - centre)[..., :2]
        ahead = way / way.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        before = ((tool - centre)[..., :2] * ahead).sum(-1) + 0.5 * contact
        low = torch.sigmoid((_LEVEL - (tool - centre)[..., 2]) / 0.005)
        return low * before.clamp(0.0, 2.0 * contact)

    return term


def pressing(name: str, gripper: Gripper, contact: float, clear: float = _CLEAR) -> Term:
    """How far (B,) a tool at the object's upper edge is from the heights at which it would not press it down, metres.

    Args:
        name: the object.
        gripper: that pushes.
        contact: distance, metres, of the tool from the object's centre where it pushes.
        clear: metres over the object's centre from which the tool does not touch it.
    """

    def term(points: Points, info: Info) -> Tensor:
        offset = contacts.tool_centre(points, gripper) - contacts.centre(points, name)
        beside = torch.sigmoid((contact + _REACH - offset[..., :2].norm(dim=-1)) / 0.005)
        height = offset[..., 2]
        return beside * torch.minimum(height - _SLACK, clear - height).clamp_min(0.0)

    return term


def pushing_terms(
    name: str, gripper: Gripper, contact: float, slide: Slide | None = None, clear: float = _CLEAR
) -> dict[str, tuple[float, Term]]:
    """Weighted terms of a planner's cost: the object near its goal, the tool behind it and not on the table.

    Args:
        name: the object.
        gripper: that pushes.
        contact: distance, metres, of the tool from the object's centre where it pushes.
        slide: how friction slows the object down; None: it stops at once.
        clear: metres over the object's centre from which the tool does not touch it.
    """
    return {
        "goal_distance": (2.0, goal_distance(name, slide)),
        "behind": (8.0, behind(name, gripper, contact)),
        "wrong_side": (8.0, wrong_side(name, gripper, contact)),
        "pressing": (20.0, pressing(name, gripper, contact, clear)),
        "ground_contact": (0.5, terms.ground_contact),
    }
