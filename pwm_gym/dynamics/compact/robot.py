"""How the robot moves: arms by their joints' response and kinematics, fingers along their joints.

Hands that press on one body from both sides hold each other up: each makes its own way in part, and in part the mean of
all. What shares they make is learned, an axis at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.compact.arm import ArmResponse
from pwm_gym.dynamics.compact.gantry import GantryResponse
from pwm_gym.dynamics.compact.gates import gate
from pwm_gym.dynamics.compact.joint_response import STEP, ArmForecast, JointResponse
from pwm_gym.dynamics.compact.movers import Scales
from pwm_gym.dynamics.protocols import Transitions
from pwm_gym.dynamics.response import LinearResponse, twist, twists
from pwm_gym.errors import SceneError
from pwm_gym.robots import Arm, Control
from pwm_gym.scene import Layout
from pwm_gym.scene.se3 import make_pose, rotation_from_vector

__all__ = ["RobotForecast", "RobotMotion"]

_POSITION, _ANGLE = 0.01, 1.0  # metres, and radians, of a driven joint's position that count as 1
_SLIDE, _TURN = 0.005, 0.05  # the same of its step
_APART = -3.0  # at which hands do not hold each other up


@dataclass(frozen=True)
class RobotForecast:
    """What is known of the robot's next step before the tokens are decoded."""

    positions: Tensor
    """Positions (B, 3, S) of the driven joints at t, t-1, t-2."""
    joint_step: Tensor
    """Their linear response (B, S)."""
    hands: Tensor
    """The hands' next poses (B, H, 4, 4) by their fitted response."""
    twists: Tensor
    """Their ways there (B, H, 6), world frame."""
    links: Tensor
    """All links' next poses (B, L, 4, 4)."""
    arms: tuple[ArmForecast | None, ...]
    """Of each hand's arm, where its chain is known."""


class RobotMotion(nn.Module):
    """The links' next poses.

    Args:
        links: the robot's entities.
        control: what actions mean.
        width: channels of a token.
        arm_width: channels of the networks of the arms' response.
        kinematic: whether known chains are used, of arms whose tool is what actions translate, and gantries.
    """

    position_units: Tensor
    step_units: Tensor

    def __init__(self, links: Layout, control: Control, width: int, arm_width: int, kinematic: bool) -> None:
        super().__init__()
        self.response = LinearResponse(links, control.size, control.drives_to_targets)
        self._targets = control.drives_to_targets
        self.hands, self.count = list(links.hands), len(links)
        arms = {arm.hand: arm for arm in control.arms if kinematic and _is_known(arm, control)}
        names = [links.names[k] for k in self.hands]
        for arm in control.arms:
            if arm.hand not in names:
                raise SceneError(
                    f"arm {arm.name!r} has hand {arm.hand!r}; the robot's are {', '.join(names) or 'none'}"
                )
        self.arms = nn.ModuleList(_response(arms[n], control, arm_width) if n in arms else nn.Identity() for n in names)
        self.known = [n in arms for n in names]
        sizes = [a.joints if isinstance(a, JointResponse) else 0 for a in self.arms]
        self.slices = [slice(sum(sizes[:k]), sum(sizes[: k + 1])) for k in range(len(names))]
        self.robot_slices = [arms[n].joints for n in names if n in arms]
        self.joints = sum(sizes)
        self.arm_tokens = nn.ModuleList(
            nn.Linear(a.features, width) if isinstance(a, JointResponse) else nn.Identity() for a in self.arms
        )
        self.heads = nn.ModuleList(nn.Linear(width, 2 * n if n else 6) for n in sizes)
        self.slide = nn.Linear(width, 1)
        self.coupling = None
        if len(names) > 1:
            self.coupling = nn.Linear(width, 3)  # shares of the hands' mean way, along the frame's axes
            nn.init.zeros_(self.coupling.weight)
            nn.init.constant_(self.coupling.bias, _APART)
        for head in (*self.heads, self.slide):
            nn.init.zeros_(head.weight)
            nn.init.zeros_(head.bias)
        commands = [c.slice for c in control.of_kind("translation", "rotation", "yaw", "joint")]
        self._commands = [k for part in commands for k in range(part.start, part.stop)]
        kinds = [e.joint.kind for e in links if e.joint.moves]
        for name, slide, turn in (("position_units", _POSITION, _ANGLE), ("step_units", _SLIDE, _TURN)):
            units = torch.tensor([slide if kind == "prismatic" else turn for kind in kinds])
            self.register_buffer(name, units, persistent=False)
        self._scales = Scales()

    def observe(self, links: Tensor, joints: Tensor | None) -> Tensor | None:
        """Joint positions and velocities (..., 2, J) of all known arms, given or solved for.

        Args:
            links: poses (..., 3, L, 4, 4).
            joints: the robot's (..., 2, J'), or the arms' alone; None where they are not known.
        """
        if not self.joints:
            return None
        if joints is not None:
            return self.select(joints)
        arms = zip(self.hands, self.arms, strict=True)
        found = [arm.observe(links[..., hand, :, :]) for hand, arm in arms if isinstance(arm, JointResponse)]
        return torch.cat(found, -1)

    def select(self, joints: Tensor) -> Tensor:
        """The known arms' joints (..., J) of the robot's (..., J'), or of themselves.

        Raises:
            SceneError: the robot has fewer.
        """
        if joints.shape[-1] == self.joints:
            return joints
        if not self.joints:
            return joints[..., :0]
        most = max(place.stop for place in self.robot_slices)
        if joints.shape[-1] < most:
            raise SceneError(f"the robot has {joints.shape[-1]} joints; expected {most} at least")
        return torch.cat([joints[..., place] for place in self.robot_slices], -1)

    def fit(self, transitions: Transitions, arm_steps: int) -> None:
        """Fit the responses: the linear one in closed form, the arms' with ``arm_steps`` optimiser steps."""
        t = transitions
        self.response.fit(t.links, t.actions, t.following)
        known = [arm for arm in self.arms if isinstance(arm, JointResponse)]
        for arm, place in zip(known, self.robot_slices, strict=True):
            arm.fit(t.joints[..., place], t.actions, t.following_joints[..., place], arm_steps, t.floor)

    def forecast(self, links: Tensor, joints: Tensor | None, action: Tensor, floor: float) -> RobotForecast:
        """What is known of the step under actions (B, A), for links at poses (B, 3, L, 4, 4)."""
        tree, now = self.response.tree, links[:, 0, self.hands]
        arms: list[ArmForecast | None] = []
        moved = now if all(self.known) else _moved(now, self.response.hand_twists(links, action))
        hands = list(moved.unbind(1))
        for k, arm in enumerate(self.arms):
            arms.append(None)
            if isinstance(arm, JointResponse):
                assert joints is not None, "prepare() the state first"
                own = joints[..., self.slices[k]]
                arms[k] = forecast = arm(own, action, now[:, k], floor)
                hands[k] = arm.kinematics(own[:, 0] + forecast.step[:, 0])
        after = torch.stack(hands, 1) if hands else now
        positions = tree.positions(links)
        step = self.response.joint_step(positions, action)
        placed = self._placed(links[:, 0], after, tree.limit(positions[:, 0] + step))
        return RobotForecast(positions, step, after, twist(now, after), placed, tuple(arms))

    def _placed(self, links: Tensor, hands: Tensor, positions: Tensor) -> Tensor:
        """Links' poses (B, L, 4, 4) with hands at (B, H, 4, 4) and driven joints at (B, S)."""
        if not self.count:
            return links
        moved = list(links.unbind(1))
        for place, pose in zip(self.hands, hands.unbind(1), strict=True):
            moved[place] = pose
        return self.response.tree.place(torch.stack(moved, 1), positions, links)

    def tokens(self, forecast: RobotForecast, tokens: Tensor) -> Tensor:
        """Link tokens (B, L, C) with what is known of each arm added to its hand's."""
        if not self.joints:
            return tokens
        rows = list(tokens.unbind(1))
        for hand, arm, layer in zip(self.hands, forecast.arms, self.arm_tokens, strict=True):
            if arm is not None:
                rows[hand] = rows[hand] + layer(arm.features)
        return torch.stack(rows, 1)

    def move(
        self,
        links: Tensor,
        joints: Tensor | None,
        action: Tensor,
        forecast: RobotForecast,
        tokens: Tensor,
        frame: Tensor,
    ) -> tuple[Tensor, Tensor | None]:
        """Next poses (B, L, 4, 4) and arms' joints (B, 2, J).

        Args:
            links: poses (B, 3, L, 4, 4).
            joints: of the arms (B, 2, J).
            action: (B, A).
            forecast: of the step.
            tokens: the links' (B, L, C).
            frame: rotation (B, 3, 3) of the frame of reference.
        """
        hands, found = [], []
        for k, (hand, arm) in enumerate(zip(self.hands, self.arms, strict=True)):
            learned, known = self.heads[k](tokens[:, hand]), forecast.arms[k]
            if isinstance(arm, JointResponse) and known is not None:
                assert joints is not None
                correction = STEP * known.motion_gate.unsqueeze(1) * learned.unflatten(1, (2, -1))
                step, velocity = (known.step + correction).unbind(1)
                asked = joints[:, 0, self.slices[k]] + step
                angles = arm.kinematics.limit(asked)
                found.append(torch.stack([angles, arm.stop(velocity, asked, angles)], 1))
                hands.append(arm.kinematics(angles))
            else:
                hands.append(self._free_hand(k, links[:, :, hand], action, forecast.twists[:, k], learned, frame))
        if self.coupling is not None:
            hands, found = self._coupled(links[:, 0, self.hands], hands, found, tokens, frame)
        tree, positions = self.response.tree, forecast.positions[:, 0] + forecast.joint_step
        if len(tree):
            positions = positions + self.slide(tokens[:, tree.moving]).squeeze(-1) * self.step_units
        placed = self._placed(links[:, 0], torch.stack(hands, 1) if hands else forecast.hands, tree.limit(positions))
        return placed, torch.cat(found, -1) if found else None

    def _coupled(
        self, now: Tensor, hands: list[Tensor], joints: list[Tensor], tokens: Tensor, frame: Tensor
    ) -> tuple[list[Tensor], list[Tensor]]:
        """Hands' next poses (B, 4, 4) and known arms' joints (B, 2, J) where hands hold each other up.

        Args:
            now: the hands' present poses (B, H, 4, 4).
            hands: their next poses alone.
            joints: the known arms' joints alone.
            tokens: the links' (B, L, C).
            frame: rotation (B, 3, 3) of the frame of reference.
        """
        assert self.coupling is not None
        share = gate(self.coupling(tokens[:, self.hands].mean(1)))
        if not share.requires_grad and not share.any():
            return hands, joints
        ways = torch.stack(hands, 1)[..., :3, 3] - now[..., :3, 3]  # (B, H, 3)
        lag = ((ways.mean(1, keepdim=True) - ways) @ frame * share.unsqueeze(1)) @ frame.transpose(1, 2)
        shifted = [make_pose(p[:, :3, :3], p[:, :3, 3] + way) for p, way in zip(hands, lag.unbind(1), strict=True)]
        following, rest = [], iter(joints)
        for k, arm in enumerate(self.arms):
            if isinstance(arm, JointResponse):
                angles, velocity = next(rest).unbind(1)
                reached = arm.kinematics.limit(arm.reach(shifted[k], angles))
                following.append(torch.stack([reached, velocity + reached - angles], 1))
                shifted[k] = arm.kinematics(reached)
        return shifted, following

    def _free_hand(
        self, k: int, frames: Tensor, action: Tensor, moved: Tensor, learned: Tensor, frame: Tensor
    ) -> Tensor:
        """Next pose (B, 4, 4) of a hand whose arm is not known, from its poses (B, 3, 4, 4)."""
        turned = frame.transpose(1, 2)
        way = (learned[:, None, :3] @ turned).squeeze(1) * self._scales.translation
        turn = (learned[:, None, 3:] @ turned).squeeze(1) * self._scales.rotation
        step = torch.cat([way, turn], 1)
        if not self._targets:  # a target asks for motion wherever the hand is not there yet
            step = _motion_gate(twists(frames), action[:, self._commands or slice(None)]) * step
        pose = _moved(frames[:, 0], moved + step)
        position = self.response.confine(pose[:, None, :3, 3].expand(-1, len(self.hands), -1))[:, k]
        return make_pose(pose[:, :3, :3], position)


def _is_known(arm: Arm, control: Control) -> bool:
    """Whether the joints of an arm are what moves: not those of a chain that actions turn one by one."""
    steered = arm.chain is not None and control.channel(arm.name, "translation") is not None
    return steered or arm.gantry is not None


def _response(arm: Arm, control: Control, width: int) -> JointResponse:
    """The response of a known arm."""
    kind = ArmResponse if arm.gantry is None else GantryResponse
    return kind(arm, control, width)


def _moved(pose: Tensor, move: Tensor) -> Tensor:
    """Poses (..., 4, 4) after twists (..., 6)."""
    return make_pose(rotation_from_vector(move[..., 3:]) @ pose[..., :3, :3], pose[..., :3, 3] + move[..., :3])


def _motion_gate(motion: Tensor, command: Tensor) -> Tensor:
    """0 where a hand rests without a command, near 1 elsewhere; (B, 1).

    Args:
        motion: two last twists (B, 2, 6).
        command: components of the action that move hands (B, K).
    """
    scales = Scales()
    unit = motion.new_tensor([scales.translation] * 3 + [scales.rotation] * 3)
    size = (motion / unit).square().sum((-1, -2)) + command.square().sum(-1)
    return torch.tanh(10.0 * ((size + 1e-12).sqrt() - 1e-6)).unsqueeze(-1)  # a finite slope at rest, and zero there
