"""The default world model: small enough to train on two CPU cores and to plan with in real time.

Like the paper's network it encodes the completed cloud, attends to an action token and to register tokens, and decodes
a motion; unlike it, points are pooled to one token an entity and the decoded motion is rigid, so that shapes never
drift. With one hand everything is expressed in its frame together with where the base and the vertical are, which
makes the model exactly equivariant to turns about the base's vertical axis; with several, in the base's axes about
their middle.

- The robot moves by what is known of it, with learned corrections (:mod:`pwm_gym.dynamics.compact.robot`). Its links
  have weights of their own.
- Of everything else the parameters depend neither by number nor by name nor by order: shapes, joints and contacts
  (:mod:`pwm_gym.dynamics.compact.contact`) tell what an entity is, and so one set of weights serves any scene of its
  robot. How it moves: :mod:`pwm_gym.dynamics.compact.movers`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.compact.attention import Block
from pwm_gym.dynamics.compact.contact import Contacts, MoverContacts
from pwm_gym.dynamics.compact.movers import MoverMotion, Scales
from pwm_gym.dynamics.compact.plan import Plan
from pwm_gym.dynamics.compact.robot import RobotForecast, RobotMotion
from pwm_gym.dynamics.compact.shapes import LinkShapes, Shapes
from pwm_gym.dynamics.compact.uncertainty import ErrorHead
from pwm_gym.dynamics.protocols import Transitions
from pwm_gym.dynamics.response import twists
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Control
from pwm_gym.scene import Layout, RigidState, State
from pwm_gym.scene.joint import JOINT_KINDS
from pwm_gym.scene.se3 import inverse, make_pose

__all__ = ["CompactConfig", "CompactModel"]

# Scale that brings lengths to order 1, metres.
_LENGTH = 0.1
_GRAVITY = 9.81
_PLANS = 32  # layouts that are remembered


@dataclass(frozen=True)
class CompactConfig:
    """Hyper-parameters of :class:`CompactModel`."""

    points: int = 32
    """Points of each entity that the network reads (the first of its cloud, which are well spread)."""
    searched: int = 128
    """Points of each entity that contact moves, the nearest of which to other entities take the place of half of those
    that are read; 0 reads the same points at every step."""
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
    """Whether a known arm's joints are what moves; otherwise its hand moves freely."""
    arm_width: int = 128
    """Channels of the network of the joints' response."""
    hidden_gaps: tuple[float, float] = (0.0, 0.0)
    """Gaps between robot and loose object, from and to, metres, at which the object is hidden from the robot's tokens:
    near, but not touching. Equal ones hide nothing."""
    hidden_from_all: bool = True
    """Whether such an object is hidden from all other tokens, so that none of them tells the robot's of it."""
    uncertain: bool = True
    """Whether it tells how far off it may be (``RigidState.error``)."""


class CompactModel(nn.Module):
    """Rigid motions of entity tokens; implements :class:`pwm_gym.dynamics.WorldModel`.

    Args:
        layout: entities of a scene; those that the robot drives are what the model belongs to.
        control: what the action's components mean.
        config: hyper-parameters.
    """

    def __init__(self, layout: Layout, control: Control | None = None, config: CompactConfig | None = None) -> None:
        super().__init__()
        self.links, self.control, self.config = layout.robot(), control or Control(), config or CompactConfig()
        self.action_size = self.control.size
        if self.config.blocks < 1:
            raise PwmGymError(f"blocks={self.config.blocks}; expected at least 1")
        if not 0.0 <= self.config.hidden_gaps[0] <= self.config.hidden_gaps[1]:
            raise PwmGymError(f"hidden_gaps={self.config.hidden_gaps}; expected 0 <= from <= to")
        c, count = self.config, len(self.links)
        fall = -_GRAVITY * self.control.period**2
        self.robot = RobotMotion(self.links, self.control, c.width, c.arm_width, c.kinematic)
        shared = 7 + 18 * len(self.links.hands) + 4 * len(self.robot.response.tree)
        self.token = nn.Linear(24 + shared, c.width)  # see _features
        self.link_kind = nn.Parameter(0.02 * torch.randn(count, c.width))
        self.other_kind = nn.Parameter(0.02 * torch.randn(len(JOINT_KINDS), c.width))
        self.action = nn.Sequential(nn.Linear(self.action_size, c.width), nn.GELU(), nn.Linear(c.width, c.width))
        self.register = nn.Parameter(0.02 * torch.randn(c.registers, c.width))
        self.shapes = LinkShapes(c.point_width, c.width)
        self.contact = MoverContacts(count, list(self.links.hands), c.point_width, c.width, fall)
        self.blocks = nn.ModuleList(Block(c.width, c.heads, c.mlp_ratio) for _ in range(c.blocks))
        self.norm = nn.LayerNorm(c.width)
        self.movers = MoverMotion(count, c.width, fall, Scales())
        self.error = ErrorHead(c.width) if c.uncertain else None
        scales = Scales()
        units = torch.tensor([scales.translation, scales.rotation] * 2).unsqueeze(-1)
        self.motion_units: Tensor
        self.register_buffer("motion_units", units, persistent=False)  # (4, 1)
        self._plans: dict[int, Plan] = {}

    def plan(self, layout: Layout) -> Plan:
        """What of ``layout`` plays which part; worked out once.

        Raises:
            SceneError: its robot is not the model's.
        """
        found = self._plans.get(id(layout))
        device = self.register.device
        if len(self._plans) > _PLANS:
            self._plans.clear()
        if found is None or found.layout is not layout or found.kinds.device != device:
            with torch.inference_mode(False):  # a planner may be the first to ask, and a training the next
                found = self._plans[id(layout)] = Plan.build(layout, self.links, device)
        return found

    def prepare(self, state: State) -> RigidState:
        """Entity poses of ``state`` and the arms' joints, each registered or solved for where it has none.

        An expected error starts from zero; in training there is none.

        Raises:
            SceneError: the scene's robot is not the model's.
        """
        plan = self.plan(state.layout)
        if not isinstance(state, RigidState):
            state = RigidState(state.layout, state.clouds, state.history())
        joints = self.robot.observe(state.frames[..., plan.order[: plan.links], :, :], state.joints)
        tells = self.error is not None and not self.training
        error = state.frames.new_zeros(*state.batch, len(state.layout)) if tells else None
        return replace(state, joints=joints, error=error)

    @property
    def read_points(self) -> int:
        """Points of each entity that it reads."""
        return max(self.config.points, self.config.searched)

    def own_joints(self, joints: Tensor) -> Tensor:
        """The known arms' joints (..., 2, J) of the robot's (..., 2, J')."""
        return self.robot.select(joints)

    def fit_response(self, transitions: Transitions, arm_steps: int) -> None:
        """Fit the robot's responses on single steps."""
        self.robot.fit(transitions, arm_steps)

    def step(self, state: State, action: Tensor) -> RigidState:
        """State (B,) one control step after action (B, A)."""
        return self.step_with_tokens(state, action)[0]

    def step_with_tokens(self, state: State, action: Tensor) -> tuple[RigidState, Tensor]:
        """The same, and the entity tokens (B, E, C) that its motions were decoded from."""
        assert isinstance(state, RigidState)
        plan = self.plan(state.layout)
        poses = state.frames if plan.sorted else state.frames[:, :, plan.order]  # (B, 3, P, 4, 4)
        links, moves = poses[:, :, : plan.links], twists(poses.transpose(1, 2))  # (B, P, 2, 6)
        shapes = self._shapes(state, plan)

        # What is known: the robot's response, and where everything is going.
        forecast = self.robot.forecast(links, state.joints, action, plan.floor)
        frames = torch.stack([self._frame(poses[:, 0]), self._frame(forecast.links)], 1)  # (B, 2, 4, 4)
        seen = inverse(frames)[:, :, :3]

        # Tokens: entities with their contacts, the action, registers.
        tokens = self._features(plan, poses, moves, forecast, frames[:, 0])
        told = self.shapes(shapes, links[:, 0], forecast.links, seen[:, 0], plan.floor)
        rows = [self.robot.tokens(forecast, tokens[:, : plan.links] + told)]
        contacts = None
        if plan.places:
            contacts = self.contact(plan, poses, shapes, moves[:, :, 0], forecast.links, frames, seen)
            rows.append(self._with_contacts(plan, tokens[:, plan.links :], contacts.told))
        elif len(plan.order) > plan.links:
            rows.append(tokens[:, plan.links :])
        visible = None if contacts is None else self._visible(plan, contacts)
        tokens = self._attend(torch.cat(rows, 1), self._turned(action, frames[:, 0, :3, :3]), visible)

        # Motions: the robot first, then what it moves.
        links_next, joints = self.robot.move(
            links, state.joints, action, forecast, tokens[:, : plan.links], frames[:, 0, :3, :3]
        )
        following = torch.cat([links_next, poses[:, 0, plan.links :]], 1)
        if contacts is not None:
            rotation = frames[:, 0, :3, :3]
            following = self.movers(plan, poses, moves[:, :, 0], shapes, contacts, tokens, links_next, rotation)
        elif plan.attached:
            following = plan.tree.place(following, following.new_zeros(len(following), 0), poses[:, 0])
        if not plan.sorted:
            following, tokens = following[:, plan.back], tokens[:, plan.back]
        error = None
        if self.error is not None and state.error is not None:
            error = state.error + self.error(tokens)
        return state.advance(following, joints, error), tokens

    def _shapes(self, state: RigidState, plan: Plan) -> Shapes:
        """The canonical points that are read, equally many of each entity, and more of the movers'."""
        every = [state.layout.entities[k] for k in plan.order]
        least = min(e.points for e in every)
        count, searched = min(self.config.points, least), min(self.config.searched, least)
        points = torch.stack([state.clouds[:, e.start : e.start + count] for e in every], 1)
        clouds = None
        if searched > count and plan.places and plan.partners:
            movers = [every[k] for k in plan.places]
            clouds = torch.stack([state.clouds[:, e.start : e.start + searched] for e in movers], 1)
        return Shapes.of(points, plan.movers, clouds)

    def _frame(self, poses: Tensor) -> Tensor:
        """Frame of reference (B, 4, 4) at poses (B, P, 4, 4): the hand's, or base axes about the hands' middle."""
        hands = self.robot.hands
        if len(hands) == 1:
            return poses[:, hands[0]]
        turn = torch.eye(3, device=poses.device).expand(len(poses), 3, 3)
        middle = poses[:, hands][..., :3, 3].mean(1) if hands else poses.new_zeros(len(poses), 3)
        return make_pose(turn, middle)

    def _turned(self, action: Tensor, rotation: Tensor) -> Tensor:
        """Action (B, A) with its vectors in the frame of reference."""
        parts = []
        for channel in self.control.channels:
            part = action[:, channel.slice]
            vector = channel.kind in ("translation", "rotation")
            parts.append((part.unsqueeze(1) @ rotation).squeeze(1) if vector else part)
        return torch.cat(parts, 1) if parts else action

    def _visible(self, plan: Plan, contacts: Contacts) -> Tensor | None:
        """1 where of the tokens [entities, action, registers] one sees another, else 0 (B, T, T); None shows all.

        Links, action and registers do not see a loose object that is near and not touched: else one in a place that no
        training had, such as something small in a drawer, could stop an arm in mid-air.
        """
        least, most = self.config.hidden_gaps
        if least == most or not plan.links or not plan.loose:
            return None
        to_robot = [gap[:, : len(plan.loose), : plan.links].amin(-1) for gap in contacts.gaps]
        gap = torch.minimum(*to_robot)
        count = len(plan.order)
        total = count + 1 + self.config.registers
        visible = gap.new_ones(len(gap), total, total)
        robot = gap.new_ones(len(gap), total)
        robot[:, plan.loose_places] = ((gap <= least) | (gap > most)).to(gap)
        if self.config.hidden_from_all:  # else what sees it tells the robot of it in the next block
            return torch.maximum(robot.unsqueeze(1), torch.eye(total, device=gap.device, dtype=gap.dtype))
        visible[:, : plan.links] = visible[:, count:] = robot.unsqueeze(1)
        return visible

    def _attend(self, entities: Tensor, action: Tensor, visible: Tensor | None) -> Tensor:
        """Entity tokens (B, P, C) after attention over [entities, action, registers], each over what is visible."""
        registers = self.register.expand(len(action), -1, -1)
        tokens = torch.cat([entities, self.action(action).unsqueeze(1), registers], 1)
        for block in self.blocks[:-1]:
            tokens = block(tokens, visible=visible)
        return self.norm(self.blocks[-1](tokens, read=entities.shape[1], visible=visible))

    @staticmethod
    def _with_contacts(plan: Plan, tokens: Tensor, told: Tensor) -> Tensor:
        """Tokens (B, P - L, C) of what is not driven, with what contacts tell the movers (B, F, C) added."""
        if isinstance(plan.movers, slice) and told.shape == tokens.shape:
            return tokens + told
        places = torch.tensor(plan.places, device=tokens.device) - plan.links
        return tokens.index_add(1, places, told)

    def _features(self, plan: Plan, poses: Tensor, moves: Tensor, forecast: RobotForecast, frame: Tensor) -> Tensor:
        """Entity tokens (B, P, C) of poses (B, 3, P, 4, 4) and motions (B, P, 2, 6) as seen from the frame (B, 4, 4).

        Each knows its own pose and motion, where base and vertical are, and how the hands and driven joints move.
        """
        count, hands, now = poses.shape[2], self.robot.hands, poses[:, 0]
        origin = frame[:, :3, 3]
        rows = [  # vectors in the world frame: one product takes them to the frame of reference
            now[..., :3, :3].transpose(-1, -2).flatten(1, 2),
            now[..., :3, 3] - origin.unsqueeze(1),
            origin.unsqueeze(1),
            moves.unflatten(-1, (2, 3)).flatten(1, 3),
            forecast.twists.unflatten(-1, (2, 3)).flatten(1, 2),
        ]
        seen = torch.cat(rows, 1) @ frame[:, :3, :3]
        axes, offset, base, motion, ahead = seen.split([3 * count, count, 1, 4 * count, 2 * len(hands)], 1)
        motion = motion.unflatten(1, (count, 4)) / self.motion_units  # (B, P, 4, 3): at t and t-1, way and turn
        ahead = ahead.unflatten(1, (len(hands), 2)) / self.motion_units[:2]
        height = (origin[:, 2:] - plan.floor).clamp(-1.0, 1.0)
        positions = forecast.positions
        speeds = self.robot.response.tree.between(positions[:, 1:], positions[:, :2])
        shared = torch.cat(
            [
                base.squeeze(1) / _LENGTH,
                frame[:, 2, :3],
                height / _LENGTH,
                torch.cat([motion[:, hands], ahead], 2).flatten(1),
                positions[:, 0] / self.robot.position_units,
                (speeds / self.robot.step_units).flatten(1),
                forecast.joint_step / self.robot.step_units,
            ],
            1,
        )
        own = [axes.unflatten(1, (count, 3)).transpose(-1, -2).flatten(2), offset / _LENGTH, motion.flatten(2)]
        tokens = self.token(torch.cat([*own, shared.unsqueeze(1).expand(-1, count, -1)], -1))
        return tokens + torch.cat([self.link_kind, self.other_kind[plan.kinds]])
