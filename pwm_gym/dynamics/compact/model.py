"""The default world model: small enough to train on two CPU cores and to plan with in real time.

Like the paper's network it encodes the completed cloud, attends to an action token and to register tokens, and decodes
a motion; unlike it, points are pooled to one token an entity and the decoded motion is rigid, so that shapes never
drift. Everything is expressed in the end effector's frame together with where the robot's base and the vertical are,
which makes the model exactly equivariant to turns about the base's vertical axis.

- Where the arm is known, its joints move by their fitted response (:mod:`pwm_gym.dynamics.compact.arm`) plus a learned
  correction for contacts, and the root link goes where its kinematics say. Elsewhere the root link moves by its linear
  response (:mod:`pwm_gym.dynamics.response`) plus a learned twist. Both corrections vanish at rest without a command.
- Links that slide on the root move along their joints, within the joints' limits.
- Every other entity moves by ``a * (the end effector's motion) + f * (free flight) + m * (a learned twist)``, with
  gates that reach 0 and 1 exactly: an untouched object rests and a held one does not slip, for any number of steps.
- Tokens are told of shapes and of imminent contacts (:mod:`pwm_gym.dynamics.compact.contact`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.dynamics.compact.arm import STEP, ArmOutlook, ArmResponse
from pwm_gym.dynamics.compact.contact import FALL, ContactFeatures
from pwm_gym.dynamics.compact.uncertainty import ErrorHead
from pwm_gym.dynamics.response import LinearResponse, twist, twists
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Control
from pwm_gym.scene import Layout, RigidState, State
from pwm_gym.scene.se3 import make_pose, rotation_from_vector, transform

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
    root: Tensor
    """The root link's pose (B, 4, 4) by its fitted response."""
    twist: Tensor
    """Its way there (B, 6), world frame."""
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
        self.token = nn.Linear(24 + 7 + 18 + 4 * sliders, c.width)  # see _entities
        units = torch.tensor([_TRANSLATION, _ROTATION, _TRANSLATION, _ROTATION]).unsqueeze(-1)
        self.motion_units: Tensor
        self.register_buffer("motion_units", units, persistent=False)  # (4, 1)
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
        chain = self.control.arms[0].chain if self.control.arms else None
        if c.kinematic and chain is not None:
            joints = chain.joints
            self.arm = ArmResponse(chain, self.control, c.arm_width)
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
        outlook, moves = self._foresee(state, action), twists(state.frames.transpose(1, 2))  # (B, E, 2, 6)
        tokens = self._tokens(state, moves, outlook, action)  # (B, E, C)
        root, joints = self._root(state, outlook, tokens, action)
        error = None
        if self.error is not None and state.error is not None:
            error = state.error + self.error(tokens)
        return state.advance(self._move(state, moves, outlook, root, self.head(tokens)), joints, error), tokens

    def _foresee(self, state: RigidState, action: Tensor) -> _Outlook:
        openings, now = self.response.effector.openings(state.frames), self._roots(state.frames)[:, 0]
        if self.arm is None:
            step, slide = self.response(state.frames, openings, action)
            return _Outlook(openings, slide, _moved(now, step), step)
        assert state.joints is not None, "prepare() the state first"
        arm = self.arm(state.joints, action, now)
        root = self.arm.kinematics(state.joints[:, 0] + arm.step[:, 0])
        return _Outlook(openings, self.response.slide(openings, action), root, twist(now, root), arm)

    def _tokens(self, state: RigidState, moves: Tensor, outlook: _Outlook, action: Tensor) -> Tensor:
        """Entity tokens (B, E, C) after attention over [entities, action, registers]."""
        entities = self._entities(state.frames, moves, outlook)
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
        openings = effector.limit(outlook.openings[:, 0] + outlook.slide)
        return now, torch.cat([outlook.root.unsqueeze(1), effector.links(outlook.root, openings)], 1)

    def _roots(self, frames: Tensor) -> Tensor:
        """Poses (B, 3, 4, 4) of the root link."""
        return frames[:, :, self.response.effector.root]

    def _turned(self, action: Tensor, rotation: Tensor) -> Tensor:
        """Action (B, A) with its vectors in the end effector's frame."""
        parts, start = [], 0
        for a, b in self._vectors():
            parts += [action[:, start:a], (action[:, None, a:b] @ rotation).squeeze(1)]
            start = b
        return torch.cat([*parts, action[:, start:]], 1)

    def _entities(self, frames: Tensor, moves: Tensor, outlook: _Outlook) -> Tensor:
        """Entity tokens (B, E, C) of poses (B, 3, E, 4, 4) and motions (B, E, 2, 6) as the end effector sees them.

        Each knows its own pose and motion, where base and vertical are, and how the end effector moves.
        """
        count, root, now = len(self.layout), self.response.effector.root, frames[:, 0]
        origin = now[:, root, :3, 3]
        rows = [  # vectors in the world frame: one product takes them to the end effector's
            now[..., :3, :3].transpose(-1, -2).flatten(1, 2),
            now[..., :3, 3] - origin.unsqueeze(1),
            origin.unsqueeze(1),
            moves.unflatten(-1, (2, 3)).flatten(1, 3),
            outlook.twist.unflatten(-1, (2, 3)),
        ]
        seen = torch.cat(rows, 1) @ now[:, root, :3, :3]
        axes, offset, base, motion, ahead = seen.split([3 * count, count, 1, 4 * count, 2], 1)
        motion = motion.unflatten(1, (count, 4)) / self.motion_units  # (B, E, 4, 3): at t and t-1, way and turn
        ahead = ahead / self.motion_units[:2]
        openings, own = outlook.openings, motion[:, root]
        shared = torch.cat(
            [
                base.squeeze(1) / _LENGTH,
                now[:, root, 2, :3],
                origin[:, 2:] / _LENGTH,
                torch.stack([own[:, 0], own[:, 2], ahead[:, 0], own[:, 1], own[:, 3], ahead[:, 1]], 1).flatten(1),
                openings[:, 0] / _NEAR,
                (openings[:, :2] - openings[:, 1:]).flatten(1) / _OPENING,
                outlook.slide / _OPENING,
            ],
            1,
        )
        parts = [
            axes.unflatten(1, (count, 3)).transpose(-1, -2).flatten(2),
            offset / _LENGTH,
            motion.flatten(2),
            shared.unsqueeze(1).expand(-1, count, -1),
        ]
        return self.token(torch.cat(parts, -1)) + self.kind

    def _move(self, state: RigidState, moves: Tensor, outlook: _Outlook, root: Tensor, decoded: Tensor) -> Tensor:
        """Next poses (B, E, 4, 4), given the root link's (B, 4, 4) and decoded tokens (B, E, 9)."""
        effector, free, now = self.response.effector, self.contact.free, state.poses()
        before = now[:, effector.root]
        moved = list(now.unbind(1))
        moved[effector.root] = root
        if effector.sliding:
            slide = outlook.slide + decoded[:, effector.sliding, 2] * _OPENING
            widths = effector.limit(outlook.openings[:, 0] + slide)
            for k, pose in zip(effector.sliding, effector.links(root, widths).unbind(1), strict=True):
                moved[k] = pose
        if free:
            poses = self._move_objects(state, moves[:, free], before, root, decoded[:, free])
            for k, pose in zip(free, poses.unbind(1), strict=True):
                moved[k] = pose
        return torch.stack(moved, 1)

    def _move_objects(self, state: RigidState, moves: Tensor, before: Tensor, root: Tensor, decoded: Tensor) -> Tensor:
        """Next poses (B, F, 4, 4) of what the robot does not drive.

        Args:
            state: the scenes.
            moves: the objects' two last motions (B, F, 2, 6).
            before: the root link's pose (B, 4, 4).
            root: its next one.
            decoded: the objects' decoded tokens (B, F, 9).
        """
        frames = state.frames[:, :2, self.contact.free]
        middle = self.contact.middles(state)  # canonical (B, F, 3)
        centre, centre_before = transform(frames, middle[:, None, :, None]).squeeze(-2).unbind(1)
        attached, moving, flying = _gate(decoded[..., [0, 1, _FLIGHT]]).split(1, -1)
        turn = twist(before, root)[:, None, 3:].expand_as(centre)
        carried = torch.cat([_carried(centre, before, root), turn], -1)
        flight, afoot = _flight(centre - centre_before, moves[:, :, 0, 3:])
        move = attached * carried + moving * self._world_twists(before, decoded[..., 2:_FLIGHT])
        return _turn_about(frames[:, 0], middle, centre, move + flying * afoot * flight)

    @staticmethod
    def _world_twists(root: Tensor, decoded: Tensor) -> Tensor:
        """World-frame twists (B, E, 6) of decoded ones (B, E, 6), which are in the frame of the root link (B, 4, 4)."""
        turned = root[:, :3, :3].transpose(-1, -2)
        return torch.cat([decoded[..., :3] @ turned * _TRANSLATION, decoded[..., 3:] @ turned * _ROTATION], -1)

    def _arm_stop(self) -> int:
        return max((b for _, b in self._vectors()), default=self.action_size)

    def _vectors(self) -> list[tuple[int, int]]:
        return [(c.start, c.stop) for c in self.control.of_kind("translation", "rotation")]


def _moved(pose: Tensor, move: Tensor) -> Tensor:
    """Pose (B, 4, 4) after a twist (B, 6)."""
    return make_pose(rotation_from_vector(move[:, 3:]) @ pose[:, :3, :3], pose[:, :3, 3] + move[:, :3])


def _carried(points: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """Displacements (B, F, 3) of world-frame points (B, F, 3) that move with a link from pose to pose (B, 4, 4)."""
    return transform(after, (points - before[:, None, :3, 3]) @ before[:, :3, :3]) - points


def _flight(gone: Tensor, turned: Tensor) -> tuple[Tensor, Tensor]:
    """Twists (B, F, 6) of free flight after ways and turns (B, F, 3) of a step, and how much these were (B, F, 1).

    The second is 0 where the object rested, so that what rests does not fall, and near 1 where it moved.
    """
    speed = (torch.cat([gone, _LEVER * turned], -1).square().sum(-1, keepdim=True) + 1e-12).sqrt()
    afoot = torch.tanh((speed - _RESTS).clamp_min(0.0) / _AFOOT)
    return torch.cat([gone + gone.new_tensor([0.0, 0.0, FALL]), turned], -1), afoot


def _turn_about(pose: Tensor, middle: Tensor, centre: Tensor, move: Tensor) -> Tensor:
    """Poses (B, F, 4, 4) moved by twists (B, F, 6) about their canonical points ``middle``, which lie at ``centre``."""
    rotation = rotation_from_vector(move[..., 3:]) @ pose[..., :3, :3]
    return make_pose(rotation, centre + move[..., :3] - (rotation @ middle.unsqueeze(-1)).squeeze(-1))


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
