"""Hands that keep their posture by themselves, so that a plan need not: upright, and turned the way the task tells.

A hand that holds a thing together with another one, or hangs on a handle, leans a little more with every step that
nobody corrects. Sampled actions hardly ever find the correction among all others; feedback needs no search.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.costs.registry import Function
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import ArmKinematics, Control
from pwm_gym.scene import EntityPoints, State

__all__ = ["PosedModel", "Posture"]

_GAIN = 0.8  # share of a turn that is asked for in a step: more overshoots where the controller lags


@dataclass(frozen=True)
class _Hand:
    """A hand that is kept in posture."""

    entity: str
    rotation: slice
    """Its place in an action."""
    unit: float
    """Radians per unit there."""
    up: Tensor
    """Axis (3,) in its frame that points up at its arm's rest."""
    heading: Function | None
    """Horizontal direction (B, 3) that its x axis shall have."""


class Posture:
    """Replaces what an action tells a hand to turn by what keeps its posture.

    A hand hangs as it does at its arm's rest, turned about the vertical: to its heading, or, where the task tells none,
    as the action says.

    Args:
        control: meaning of an action's components.
        headings: arm -> function ``(points, info) -> (B, 3)``, the horizontal direction that the x axis of its hand
            shall have.

    Raises:
        PwmGymError: no arm whose rest is known turns its hand, or a heading of another arm.
    """

    def __init__(self, control: Control, headings: Mapping[str, Function] | None = None) -> None:
        ways = dict(headings or {})
        self._hands: list[_Hand] = []
        for arm in control.arms:
            channel = control.channel(arm.name, "rotation")
            if arm.chain is None or channel is None:
                continue
            kinematics = ArmKinematics(arm.chain)
            up = kinematics(kinematics.rest.unsqueeze(0))[0, 2, :3]
            self._hands.append(_Hand(arm.hand, channel.slice, channel.unit, up, ways.pop(arm.name, None)))
        if not self._hands or ways:
            wanted = ", ".join(ways) or ", ".join(control.arm_names) or "no arm"
            raise PwmGymError(
                f"posture of {wanted}: none is known to turn its hand; expected an arm with a chain and a rotation"
            )

    def __call__(self, state: State, action: Tensor) -> Tensor:
        """Actions (B, A) that keep the posture, for actions (B, A) in states (B,)."""
        poses, points, action = state.poses(), EntityPoints(state), action.clone()
        for hand in self._hands:
            rotation = poses[:, state.layout.index(hand.entity), :3, :3]
            turn = _righting(rotation @ hand.up.to(poses))
            action[:, hand.rotation.start : hand.rotation.start + 2] = _command(turn, hand.unit)
            if hand.heading is not None:
                turn = _yaw_between(rotation[..., 0], hand.heading(points, {"action": action}))
                action[:, hand.rotation.stop - 1] = _command(turn, hand.unit)
        return action


def _command(turn: Tensor, unit: float) -> Tensor:
    """Components of an action that ask for a part of a turn, radians."""
    return (_GAIN / unit * turn).clamp(-1.0, 1.0)


def _righting(axis: Tensor) -> Tensor:
    """Turn (B, 2) about x and y that brings a unit vector (B, 3) to the vertical: about (y, -x, 0)."""
    lean = torch.atan2(axis[:, :2].norm(dim=-1, keepdim=True), axis[:, 2:])
    return lean * torch.nn.functional.normalize(torch.stack([axis[:, 1], -axis[:, 0]], -1), dim=-1)


def _yaw_between(axis: Tensor, way: Tensor) -> Tensor:
    """Turn (B,) about the vertical that brings an axis (B, 3) to a direction (B, 3)."""
    sine = axis[:, 0] * way[:, 1] - axis[:, 1] * way[:, 0]
    return torch.atan2(sine, (axis[:, :2] * way[:, :2]).sum(-1))


class PosedModel:
    """A world model whose hands keep their posture: it takes actions as :class:`Posture` changes them."""

    def __init__(self, model: WorldModel, posture: Posture) -> None:
        self.model, self.posture = model, posture
        self.links, self.action_size = model.links, model.action_size

    def prepare(self, state: State) -> State:
        """The state in the form that the model moves."""
        return self.model.prepare(state)

    def step(self, state: State, action: Tensor) -> State:
        """State (B,) one control step after the changed action (B, A)."""
        return self.model.step(state, self.posture(state, action))
