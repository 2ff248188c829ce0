"""The default world model: small enough to train on two CPU cores and to plan with in real time.

Like the paper's network it encodes the completed cloud, attends to an action token and to register tokens, and decodes
a motion; unlike it, points are pooled to one token an entity and the decoded motion is rigid, so that shapes never
drift. Everything is expressed in the end effector's frame together with where the robot's base and the vertical are,
which makes the model exactly equivariant to turns about the base's vertical axis.

- Where the arm is known, its joints move by their fitted response (:mod:`pwm_gym.dynamics.arm`) plus a learned
  correction for contacts, and the root link goes where its kinematics say. Elsewhere the root link moves by its linear
  response (:mod:`pwm_gym.dynamics.response`) plus a learned twist. Both corrections vanish at rest without a command.
- Links that slide on the root move along their joints, within the joints' limits.
- Every other entity moves by ``a * (the end effector's motion) + f * (free flight) + m * (a learned twist)``, with
  gates that reach 0 and 1 exactly: an untouched object rests and a held one does not slip, for any number of steps.
- Tokens are told of shapes and of imminent contacts (:mod:`pwm_gym.dynamics.contact`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.dynamics.arm import STEP, ArmOutlook, ArmResponse
from pwm_gym.dynamics.contact import FALL, ContactFeatures
from pwm_gym.dynamics.response import LinearResponse, twist, twists
from pwm_gym.dynamics.uncertainty import ErrorHead
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Control
from pwm_gym.scene import Layout, RigidState, State
from pwm_gym.scene.se3 import make_pose, rotation_from_vector

__all__ = ["CompactConfig", "CompactModel"]

# Scales that bring features to order 1; metres, radians, per step where it is a motion.
_LENGTH, _NEAR = 0.1, 0.01
_TRANSLATION, _ROTATION, _OPENING = 0.01, 0.05, 0.005
_LEVER = 0.01  # metres: makes a turn a speed
_RESTS, _AFOOT = 0.0005, 0.001  # metres a step: what is slower does not fly at all, or hardly
_CAP = 40.0  # of attention scores, far beyond what occurs: their exponentials stay finite
_FLIGHT = 8  # place of its gate in a decoded token


@dataclass(frozen=True)
class CompactConfig:
    """Hyper-parameters of :class:`CompactModel`."""

    points: int = 32
    """Points of each entity that the network reads (the first of its cloud, which are well spread)."""
    point_width: int = 64
    """Channels of the per-point networks."""
    width: int = 96
    """Channels of a token."""
    blocks: int = 2
    """Attention blocks over [entities, action, registers]."""
    heads: int = 4
    """Attention heads."""
    mlp_ratio: int = 2
    """Hidden width of a block's MLP over ``width``."""
    registers: int = 1
    """Register tokens (paper, Table "Effect of Register token")."""
    kinematic: bool = True
    """Whether a known arm's joints are what moves; otherwise its root link moves freely."""
    arm_width: int = 128
    """Channels of the network of the joints' response."""
    uncertain: bool = True
    """Whether it tells how far off it may be (``RigidState.error``)."""


@dataclass(frozen=True)
class _Outlook:
    """What is known of the end effector's next step before the tokens are decoded."""

    openings: Tensor
    """Sliding links' openings (B, 3, S)."""
    slide: Tensor
    """Their linear response (B, S)."""
    twist: Tensor
    """The root link's fitted response (B, 6), world frame."""
    arm: ArmOutlook | None = None


class CompactModel(nn.Module):
    """Rigid motions of entity tokens; implements :class:`pwm_gym.dynamics.WorldModel`.

    Args:
        layout: the scene's entities; exactly one effector link without a slider is the root.
        action_size: A.
        control: what the action's components mean.
        config: hyper-parameters.
    """

    def __init__(
        self,
        layout: Layout,
        action_size: int,
        control: Control | None = None,
        config: CompactConfig | None = None,
    ) -> None:
        super().__init__()
        self.layout, self.action_size, self.config = layout, action_size, config or CompactConfig()
        self.control = control or Control()
        if self.config.blocks < 1:
            raise PwmGymError(f"blocks={self.config.blocks}; expected at least 1")
        self.response = LinearResponse(layout, action_size)
        effector = self.response.effector
        c, sliders = self.config, len(effector.sliding)
        context = 7 + 18 + 4 * sliders  # see _context
        self.token = nn.Linear(24 + context, c.width)
        self.kind = nn.Parameter(0.02 * torch.randn(len(layout), c.width))
        self.action = nn.Sequential(nn.Linear(action_size, c.width), nn.GELU(), nn.Linear(c.width, c.width))
        self.register = nn.Parameter(0.02 * torch.randn(c.registers, c.width))
        self.contact = ContactFeatures(layout, effector, c.points, c.point_width, c.width)
        self.blocks = nn.ModuleList(_Block(c.width, c.heads, c.mlp_ratio) for _ in range(c.blocks))
        self.norm = nn.LayerNorm(c.width)
        self.head = nn.Linear(c.width, 9)  # attachment, movement, twist, flight
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        nn.init.constant_(self.head.bias[_FLIGHT:], -3.0)  # nothing flies
        self.arm_place: Tensor
        self.arm: ArmResponse | None = None
        if c.kinematic and self.control.arm is not None:
            joints = self.control.arm.joints
            self.arm = ArmResponse(self.control.arm, c.arm_width)
            self.arm_token = nn.Linear(self.arm.features, c.width)
            place = F.one_hot(torch.tensor(effector.root), len(layout)).float().unsqueeze(-1)
            self.register_buffer("arm_place", place, persistent=False)  # (E, 1): 1 at the root link
            self.arm_head = nn.Linear(c.width, 2 * joints)
            nn.init.zeros_(self.arm_head.weight)
            nn.init.zeros_(self.arm_head.bias)
        self.error = ErrorHead(c.width) if c.uncertain else None

    def prepare(self, state: State) -> RigidState:
        """Entity poses of ``state`` and the arm's joints, each registered or solved for where it has none.

        An expected error starts from zero; in training there is none.
        """
        if not isinstance(state, RigidState):
            state = RigidState(state.layout, state.clouds, state.history())
        joints = self.arm.observe(self._roots(state.frames), state.joints) if self.arm is not None else None
        tells = self.error is not None and not self.training
        error = state.frames.new_zeros(*state.batch, len(self.layout)) if tells else None
        return replace(state, joints=joints, error=error)

    def step(self, state: State, action: Tensor) -> RigidState:
        """State (B,) one control step after action (B, A)."""
        return self.step_with_tokens(state, action)[0]

    def step_with_tokens(self, state: State, action: Tensor) -> tuple[RigidState, Tensor]:
        """The same, and the entity tokens (B, E, C) that its motions were decoded from."""
        assert isinstance(state, RigidState)
        outlook = self._foresee(state, action)
        tokens = self._tokens(state, outlook, action)  # (B, E, C)
        root, joints = self._root(state, outlook, tokens, action)
        error = None
        if self.error is not None and state.error is not None:
            error = state.error + self.error(tokens)
        return state.advance(self._move(state, outlook, root, self.head(tokens)), joints, error), tokens

    def _foresee(self, state: RigidState, action: Tensor) -> _Outlook:
        openings = self.response.effector.openings(state.frames)
        if self.arm is None:
            step, slide = self.response(state.frames, openings, action)
            return _Outlook(openings, slide, step)
        assert state.joints is not None, "prepare() the state first"
        now = self._roots(state.frames)[:, 0]
        arm = self.arm(state.joints, action, now)
        step = twist(now, self.arm.kinematics(state.joints[:, 0] + arm.step[:, 0]))
        return _Outlook(openings, self.response.slide(openings, action), step, arm)

    def _tokens(self, state: RigidState, outlook: _Outlook, action: Tensor) -> Tensor:
        """Entity tokens (B, E, C) after attention over [entities, action, registers]."""
        entities = self._entities(state.frames, self._context(state.frames, outlook))
        entities = entities + self.contact(state, *self._links(state, outlook))
        if outlook.arm is not None:
            entities = entities + self.arm_place * self.arm_token(outlook.arm.features).unsqueeze(1)
        command = self.action(self._turned(action, self._roots(state.frames)[:, 0, :3, :3])).unsqueeze(1)
        registers = self.register.expand(len(action), -1, -1)
        tokens = torch.cat([entities, command, registers], 1)  # (B, E + 1 + R, C)
        for block in self.blocks[:-1]:
            tokens = block(tokens)
        return self.norm(self.blocks[-1](tokens, read=len(self.layout)))

    def _root(
        self, state: RigidState, outlook: _Outlook, tokens: Tensor, action: Tensor
    ) -> tuple[Tensor, Tensor | None]:
        """Next pose (B, 4, 4) of the root link, and the arm's joints (B, 2, J) where it is known."""
        token = tokens[:, self.response.effector.root]
        if self.arm is not None and outlook.arm is not None:
            assert state.joints is not None
            learned = self.arm_head(token).unflatten(1, (2, -1))
            step, velocity = (outlook.arm.step + STEP * outlook.arm.stirred.unsqueeze(1) * learned).unbind(1)
            angles = self.arm.kinematics.limit(state.joints[:, 0] + step)
            return self.arm.kinematics(angles), torch.stack([angles, velocity], 1)
        roots = self._roots(state.frames)
        learned = self._world_twists(roots[:, 0], self.head(token)[:, None, 2:_FLIGHT]).squeeze(1)
        moved = outlook.twist + _aliveness(twists(roots), action[:, : self._arm_stop()]) * learned
        root = _moved(roots[:, 0], moved)
        return make_pose(root[:, :3, :3], self.response.confine(root[:, :3, 3])), None

    def _links(self, state: RigidState, outlook: _Outlook) -> tuple[Tensor, Tensor]:
        """Poses (B, 1 + S, 4, 4) of the root link and the sliding links, now and as foreseen."""
        effector = self.response.effector
        now = state.poses()[:, [effector.root, *effector.sliding]]
        root = _moved(now[:, 0], outlook.twist)
        openings = effector.limit(outlook.openings[:, 0] + outlook.slide)
        return now, torch.cat([root.unsqueeze(1), effector.links(root, openings)], 1)

    def _roots(self, frames: Tensor) -> Tensor:
        """Poses (B, 3, 4, 4) of the root link."""
        return frames[:, :, self.response.effector.root]

    def _turned(self, action: Tensor, rotation: Tensor) -> Tensor:
        """Action (B, A) with its vectors in the end effector's frame."""
        parts, start = [], 0
        for a, b in self.control.vectors:
            parts += [action[:, start:a], (action[:, None, a:b] @ rotation).squeeze(1)]
            start = b
        return torch.cat([*parts, action[:, start:]], 1)

    def _context(self, frames: Tensor, outlook: _Outlook) -> Tensor:
        """What every token knows (B, K): base and vertical as the end effector sees them, and its motion."""
        root, openings = self._roots(frames), outlook.openings
        turn = root[:, 0, :3, :3].unsqueeze(1)  # row vectors times it are in the end effector's frame
        origin, up = root[:, 0, :3, 3], root[:, 0, 2, :3]
        motion = torch.cat([twists(root), outlook.twist.unsqueeze(1)], 1)  # (B, 3, 6): t, t-1, fitted t+1
        linear = motion[..., None, :3] @ turn / _TRANSLATION
        angular = motion[..., None, 3:] @ turn / _ROTATION
        speeds = (openings[:, :2] - openings[:, 1:]).flatten(1) / _OPENING
        seen = (origin.unsqueeze(1) @ turn.squeeze(1)).squeeze(1)
        return torch.cat(
            [
                seen / _LENGTH,
                up,
                origin[:, 2:] / _LENGTH,
                linear.flatten(1),
                angular.flatten(1),
                openings[:, 0] / _NEAR,
                speeds,
                outlook.slide / _OPENING,
            ],
            1,
        )

    def _entities(self, frames: Tensor, context: Tensor) -> Tensor:
        """Entity tokens (B, E, C) of their poses and motions (B, 3, E, 4, 4) in the end effector's frame."""
        root = self.response.effector.root
        turn = frames[:, 0, root, :3, :3].unsqueeze(1)  # (B, 1, 3, 3)
        origin = frames[:, 0, root, :3, 3].unsqueeze(1)
        rotation = turn.transpose(-1, -2) @ frames[:, 0, :, :3, :3]  # (B, E, 3, 3)
        offset = ((frames[:, 0, :, :3, 3] - origin).unsqueeze(-2) @ turn).squeeze(-2)
        moves = twists(frames.transpose(1, 2)).transpose(1, 2)  # (B, 2, E, 6)
        linear = moves[..., None, :3] @ turn.unsqueeze(1) / _TRANSLATION
        angular = moves[..., None, 3:] @ turn.unsqueeze(1) / _ROTATION
        motion = torch.cat([linear, angular], -1).squeeze(-2).transpose(1, 2).flatten(2)  # (B, E, 12)
        pose = torch.cat([rotation.flatten(2), offset / _LENGTH], -1)  # (B, E, 12)
        shared = context.unsqueeze(1).expand(-1, len(self.layout), -1)
        return self.token(torch.cat([pose, motion, shared], -1)) + self.kind

    def _move(self, state: RigidState, outlook: _Outlook, root: Tensor, decoded: Tensor) -> Tensor:
        """Next poses (B, E, 4, 4), given the root link's (B, 4, 4) and decoded tokens (B, E, 9)."""
        effector, now = self.response.effector, state.poses()
        before = now[:, effector.root]
        learned = self._world_twists(before, decoded[..., 2:_FLIGHT])  # (B, E, 6)
        moved = list(now.unbind(1))
        moved[effector.root] = root
        if effector.sliding:
            slide = outlook.slide + decoded[:, effector.sliding, 2] * _OPENING
            widths = effector.limit(outlook.openings[:, 0] + slide)
            for k, pose in zip(effector.sliding, effector.links(root, widths).unbind(1), strict=True):
                moved[k] = pose
        turn = twist(before, root)[:, 3:]
        for k in self.contact.free:
            cloud = state.clouds[:, state.layout.entities[k].slice][:, : self.config.points]
            middle = cloud.mean(1)  # canonical (B, 3); of what training sees, however many points a state has
            centre = (now[:, k, :3, :3] @ middle.unsqueeze(-1)).squeeze(-1) + now[:, k, :3, 3]
            carried = torch.cat([_carried(centre, before, root), turn], -1)
            attached, moving, flying = (_gate(decoded[:, k, i : i + 1]) for i in (0, 1, _FLIGHT))
            flight, afoot = _flight(state.frames[:, 1, k], now[:, k], middle)
            move = attached * carried + moving * learned[:, k] + flying * afoot * flight
            moved[k] = _turn_about(now[:, k], middle, centre, move)
        return torch.stack(moved, 1)

    @staticmethod
    def _world_twists(root: Tensor, decoded: Tensor) -> Tensor:
        """World-frame twists (B, E, 6) of decoded ones (B, E, 6), which are in the frame of the root link (B, 4, 4)."""
        turned = root[:, :3, :3].transpose(-1, -2)
        return torch.cat([decoded[..., :3] @ turned * _TRANSLATION, decoded[..., 3:] @ turned * _ROTATION], -1)

    def _arm_stop(self) -> int:
        return max((b for _, b in self.control.vectors), default=self.action_size)


def _moved(pose: Tensor, move: Tensor) -> Tensor:
    """Pose (B, 4, 4) after a twist (B, 6)."""
    return make_pose(rotation_from_vector(move[:, 3:]) @ pose[:, :3, :3], pose[:, :3, 3] + move[:, :3])


def _carried(point: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """Displacement (B, 3) of a world-frame point (B, 3) that moves with a link from pose to pose (B, 4, 4)."""
    local = ((point - before[:, :3, 3]).unsqueeze(1) @ before[:, :3, :3]).squeeze(1)
    return (after[:, :3, :3] @ local.unsqueeze(-1)).squeeze(-1) + after[:, :3, 3] - point


def _flight(before: Tensor, now: Tensor, middle: Tensor) -> tuple[Tensor, Tensor]:
    """Twist (B, 6) about a canonical point (B, 3) in free flight from poses (B, 4, 4), and how much it moved (B, 1).

    The second is 0 where the object rested, so that what rests does not fall, and near 1 where it moved.
    """
    gone = ((now - before)[:, :3, :3] @ middle.unsqueeze(-1)).squeeze(-1) + (now - before)[:, :3, 3]
    turned = twist(before, now)[:, 3:]
    speed = (torch.cat([gone, _LEVER * turned], -1).square().sum(-1, keepdim=True) + 1e-12).sqrt()
    afoot = torch.tanh((speed - _RESTS).clamp_min(0.0) / _AFOOT)
    return torch.cat([gone + gone.new_tensor([0.0, 0.0, FALL]), turned], -1), afoot


def _turn_about(pose: Tensor, middle: Tensor, centre: Tensor, move: Tensor) -> Tensor:
    """Pose (B, 4, 4) moved by a twist (B, 6) about its canonical point ``middle``, which lies at ``centre``."""
    rotation = rotation_from_vector(move[:, 3:]) @ pose[:, :3, :3]
    return make_pose(rotation, centre + move[:, :3] - (rotation @ middle.unsqueeze(-1)).squeeze(-1))


def _gate(logit: Tensor) -> Tensor:
    """Sigmoid stretched to reach 0 and 1 exactly, with the plain sigmoid's gradient (never zero)."""
    soft = torch.sigmoid(logit)
    return soft + (torch.clamp(1.2 * soft - 0.1, 0.0, 1.0) - soft).detach()


def _aliveness(motion: Tensor, command: Tensor) -> Tensor:
    """0 where the end effector rests without a command, near 1 elsewhere; (B, 1)."""
    scale = motion.new_tensor([_TRANSLATION] * 3 + [_ROTATION] * 3)
    size = (motion / scale).square().sum((-1, -2)) + command.square().sum(-1)
    return torch.tanh(10.0 * ((size + 1e-12).sqrt() - 1e-6)).unsqueeze(-1)  # a finite slope at rest, and zero there


class _Block(nn.Module):
    """Pre-norm attention and MLP."""

    def __init__(self, width: int, heads: int, ratio: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, ratio * width), nn.GELU(), nn.Linear(ratio * width, width))

    def forward(self, tokens: Tensor, read: int | None = None) -> Tensor:
        """Tokens (B, T, C) -> (B, T, C), or the first ``read`` of them alone."""
        mixed = self._mixed(self.qkv(self.norm1(tokens)), read)
        tokens = tokens[:, :read] + self.out(mixed)
        return tokens + self.mlp(self.norm2(tokens))

    def _mixed(self, qkv: Tensor, read: int | None) -> Tensor:
        """What the first ``read`` tokens read (B, T, C) of queries, keys and values (B, T, 3 C).

        On a CPU PyTorch's own attention takes three times as long for so few tokens: its softmax is slow on short rows.
        """
        q, k, v = qkv.unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4).contiguous().flatten(1, 2).unbind()
        scores = (q.shape[-1] ** -0.5 * q[:, :read]) @ k.transpose(-1, -2)  # (B heads, T, T)
        weights = scores.clamp(-_CAP, _CAP).exp()
        sums = weights @ F.pad(v, (0, 1), value=1.0)  # the last column is the softmax's denominator
        mixed = sums[..., :-1] / sums[..., -1:]
        return mixed.unflatten(0, (-1, self.heads)).transpose(1, 2).flatten(2)
