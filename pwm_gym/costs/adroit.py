"""Terms of the Adroit hand's tasks, told by the clouds of its links."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from pwm_gym.costs import contacts
from pwm_gym.costs.contacts import Points
from pwm_gym.costs.landmarks import fixed_place
from pwm_gym.costs.motion import angular_velocity, hinge_speeds
from pwm_gym.costs.terms import Info, Place, Term
from pwm_gym.robots.adroit import DOOR_HAND, GRASP, PALM

__all__ = ["PALM_PLACE", "distance", "squared_speeds"]

PALM_PLACE = fixed_place(PALM, GRASP)
"""The place (B, 3) before the palm that grasps, metres."""

_WRIST = 0.396  # metres from the forearm's origin to the wrist


def distance(first: Place, second: Place) -> Term:
    """Distance (B,) between two places, metres."""
    return lambda points, info: (first(points, info) - second(points, info)).norm(dim=-1)


def squared_speeds(others: Mapping[str, str | None], period: float) -> Term:
    """Sum (B,) of all joints' squared speeds, metres and radians a second.

    Args:
        others: entity -> parent of the hinges that are not the hand's.
        period: seconds of a control step.
    """
    parents = {name: joint.parent for name, joint in DOOR_HAND.joints.items()} | {"forearm": None} | dict(others)

    def term(points: Points, info: Info) -> Tensor:
        velocity = info["velocity"]
        turns = hinge_speeds(points, velocity, parents)
        wrist, forearm = contacts.centre(points, "wrist"), contacts.centre(points, "forearm")
        arm = wrist - forearm
        arm = _WRIST * arm / arm.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        turn = angular_velocity(points, velocity, "forearm")
        slid = velocity["wrist"].mean(-2) - torch.linalg.cross(turn, arm)  # of the forearm's origin
        return (turns + slid.square().sum(-1)) / period**2

    return term
