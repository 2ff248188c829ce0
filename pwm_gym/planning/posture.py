"""Hands that keep their posture by themselves, so that a plan need not: upright, turned and shaped as the task tells.

A hand that holds a thing together with another one, or hangs on a handle, leans a little more with every step that
nobody corrects. Sampled actions hardly ever find the correction among all others; feedback needs no search.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.dynamics.model import WorldModel
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import ArmKinematics, Control
from pwm_gym.scene import EntityPoints, State
from pwm_gym.tasks import HandPosture

__all__ = ["PosedModel", "Posture"]

_GAIN = 0.8  # share of a turn that is asked for in a step: more overshoots where the controller lags


@dataclass(frozen=True)
class _Hand:
    """A hand whose posture is kept."""

    entity: str
    rotation: slice
    """Its place in an action."""
    unit: float
    """Radians per unit there."""
    up: Tensor
    """Axis (3,) in its frame that points up at its arm's rest."""
    posture: HandPosture
    shaped: tuple[tuple[int, float], ...]
    """Components of an action that are finger targets which the posture decides, and these."""

    @property
    def fixed(self) -> tuple[int, ...]:
        """Components of an action that the posture decides."""
        end = self.rotation.stop - (self.posture.heading is None)
        return (*range(self.rotation.start, end), *(component for component, _ in self.shaped))


class Posture:
    """Replaces the components of an action that a hand's posture decides.

    A hand hangs as it does at its arm's rest, turned about the vertical: to its heading, or, where it has none, as the
    action says. Fingers whose shape is told go there, others as the action says.

    Args:
        control: meaning of an action's components.
        postures: arm -> what is told of its hand.

    Raises:
        PwmGymError: no arm whose rest is known turns its hand, a posture of another arm, or one of other fingers.
    """

    def __init__(self, control: Control, postures: Mapping[str, HandPosture] | None = None) -> None:
        told = dict(postures or {})
        self._hands: list[_Hand] = []
        for arm in control.arms:
            channel = control.channel(arm.name, "rotation")
            if arm.chain is None or channel is None:
                continue
            kinematics = ArmKinematics(arm.chain)
            up = kinematics(kinematics.rest.unsqueeze(0))[0, 2, :3]
            posture = told.pop(arm.name, HandPosture())
            shaped = _shaped(control, arm.name, posture.fingers)
            self._hands.append(_Hand(arm.hand, channel.slice, channel.unit, up, posture, shaped))
        if not self._hands or told:
            wanted = ", ".join(told) or ", ".join(control.arm_names) or "no arm"
            raise PwmGymError(
                f"posture of {wanted}: none is known to turn its hand; expected an arm with a chain and a rotation"
            )

    @property
    def fixed(self) -> tuple[int, ...]:
        """Components of an action that it replaces."""
        return tuple(component for hand in self._hands for component in hand.fixed)

    def __call__(self, state: State, action: Tensor) -> Tensor:
        """Actions (B, A) that keep the posture, for actions (B, A) in states (B,)."""
        poses, points, action = state.poses(), EntityPoints(state), action.clone()
        for hand in self._hands:
            rotation = poses[:, state.layout.index(hand.entity), :3, :3]
            turn = _righting(rotation @ hand.up.to(poses))
            action[:, hand.rotation.start : hand.rotation.start + 2] = _command(turn, hand.unit)
            if hand.posture.heading is not None:
                way = hand.posture.heading(points, {"action": action})
                if way.shape != rotation.shape[:2]:
                    raise PwmGymError(
                        f"heading of {hand.entity} has shape {tuple(way.shape)}; expected {tuple(rotation.shape[:2])}"
                    )
                action[:, hand.rotation.stop - 1] = _command(_yaw_between(rotation[..., 0], way), hand.unit)
            for component, target in hand.shaped:
                action[:, component] = target
        return action


def _shaped(control: Control, arm: str, fingers: tuple[float | None, ...]) -> tuple[tuple[int, float], ...]:
    """Components that are finger targets which a posture decides, and these."""
    channel = control.channel(arm, "finger")
    places = range(channel.start, channel.stop) if channel else range(0)
    if fingers and len(fingers) != len(places):
        raise PwmGymError(f"posture of {arm} has {len(fingers)} finger targets; expected {len(places)}")
    return tuple((place, target) for place, target in zip(places, fingers, strict=False) if target is not None)


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
