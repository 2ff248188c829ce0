"""World models without learning: what any learned one has to beat.

``still``: nothing moves. ``commanded``: hands go where they are told at once. ``linear``: they follow their fitted
linear response, a grasped object is attached to its hand, and a released one falls to its support.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.dynamics.protocols import Transitions
from pwm_gym.dynamics.response import LinearResponse
from pwm_gym.robots import Arm, Channel, Control
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Entity, Layout, RigidState, State, Support
from pwm_gym.scene.se3 import inverse, make_pose, matrix_from_pose7, rotation_from_vector, transform

__all__ = ["BaselineConfig", "Commanded", "LinearBaseline", "Still"]

_GRAVITY = 9.81
_UPRIGHT = 1e-3  # of an edge's length; what is shorter seen from above is upright
_REACHES = 0.01  # metres by which what is below an object may reach above its lowest point and still support it


@dataclass(frozen=True)
class BaselineConfig:
    """The grasp rule."""

    reach: float = 0.025
    """Metres between the tool centre and the object's within which a shut gripper holds it (paper, appendix)."""


class Still(nn.Module):
    """Nothing moves."""

    def __init__(self, layout: Layout, control: Control | None = None, config: BaselineConfig | None = None) -> None:
        super().__init__()
        self.links, self.control, self.config = layout.robot(), control or Control(), config or BaselineConfig()
        self.action_size = self.control.size

    def prepare(self, state: State) -> State:
        """Entity poses of ``state``."""
        return RigidState(state.layout, state.clouds, state.history())

    def step(self, state: State, action: Tensor) -> State:
        """The same poses again."""
        assert isinstance(state, RigidState)
        return state.advance(state.poses())


class LinearBaseline(Still):
    """The robot's linear response; objects attach and detach by the grasp rule and fall when let go."""

    def __init__(self, layout: Layout, control: Control | None = None, config: BaselineConfig | None = None) -> None:
        super().__init__(layout, control, config)
        self.response = LinearResponse(self.links, self.action_size, self.control.drives_to_targets)

    def fit_response(self, transitions: Transitions, arm_steps: int) -> None:
        """Fit the linear response on single steps."""
        self.response.fit(transitions.links, transitions.actions, transitions.following)

    def step(self, state: State, action: Tensor) -> State:
        """State (B,) one step later."""
        assert isinstance(state, RigidState)
        driven = [state.layout.index(name) for name in self.links.names]
        links, moved = state.frames[:, :, driven], list(state.poses().unbind(1))
        held = {k: self._held(state, k, action) for k in state.layout.loose}
        after = self._robot(links, action, list(held.values()))
        for k, pose in zip(driven, after.unbind(1), strict=True):
            moved[k] = pose
        for k, by_hand in held.items():
            moved[k] = self._fall(state, k)
            for hand, holds in zip(self.response.hands, by_hand, strict=True):
                carried = after[:, hand] @ inverse(links[:, 0, hand]) @ state.poses()[:, k]
                moved[k] = torch.where(holds[:, None, None], carried, moved[k])
        now, tree = state.poses(), _hanging(state.layout).to(action.device)
        return state.advance(tree.place(torch.stack(moved, 1), tree.positions(now), now))

    def _robot(self, links: Tensor, action: Tensor, held: list[list[Tensor]]) -> Tensor:
        """Next poses (B, L, 4, 4) of the links."""
        if not len(self.links):
            return links[:, 0]
        tree, now = self.response.tree, links[:, 0, self.response.hands]
        step = self._hand_steps(links, action)
        position = self.response.confine(now[..., :3, 3] + step[..., :3])
        hands = make_pose(rotation_from_vector(step[..., 3:]) @ now[..., :3, :3], position)
        moved = list(links[:, 0].unbind(1))
        for k, pose in zip(self.response.hands, hands.unbind(1), strict=True):
            moved[k] = pose
        before = tree.positions(links)
        joints = tree.limit(self._joints(before, action))
        for holds in (h for by_hand in held for h in by_hand):  # fingers around a held object stay where they are
            joints = torch.where(holds.unsqueeze(-1), torch.maximum(joints, before[:, 0]), joints)
        return tree.place(torch.stack(moved, 1), joints, links[:, 0])

    def _hand_steps(self, links: Tensor, action: Tensor) -> Tensor:
        """World-frame twists (B, H, 6) of the hands."""
        return self.response.hand_twists(links, action)

    def _joints(self, positions: Tensor, action: Tensor) -> Tensor:
        """Next positions (B, S) of the driven joints, before their limits."""
        return positions[:, 0] + self.response.joint_step(positions, action)

    def _held(self, state: RigidState, k: int, action: Tensor) -> list[Tensor]:
        """Whether (B,) entity ``k`` is near each hand's tool centre and its gripper is commanded shut."""
        centre = state.entity(state.layout.names[k]).mean(1)
        out = []
        for hand in self.response.hands:
            arm = next((a for a in self.control.arms if a.hand == self.links.names[hand]), None)
            gripper = self.control.channel(arm.name, "gripper") if arm else None
            shut = action[:, gripper.start] < 0 if gripper else torch.zeros(len(action), dtype=torch.bool)
            near = (centre - self._tool(state, hand, arm)).norm(dim=-1) <= self.config.reach
            out.append(near & shut.to(near.device))
        return out

    def _tool(self, state: RigidState, hand: int, arm: Arm | None) -> Tensor:
        """Tool centre (B, 3): the arm's own, or the centre of the links that hang on the hand."""
        name = self.links.names[hand]
        if arm is not None and arm.chain is not None:
            tool = state.clouds.new_tensor([arm.chain.tool])
            return transform(state.poses()[:, state.layout.index(name)], tool).squeeze(-2)
        fingers = [e.name for e in self.links if e.joint.parent == name] or [name]
        return torch.stack([state.entity(n).mean(1) for n in fingers]).mean(0)

    def _fall(self, state: RigidState, k: int) -> Tensor:
        """Pose (B, 4, 4) of a loose object: down by gravity until its lowest point touches what is below it."""
        pose, before = state.frames[:, 0, k], state.frames[:, 1, k]
        points = state.entity(state.layout.names[k])
        room = points[..., 2].amin(1) - self._support(state, k, points)
        drop = (before[:, 2, 3] - pose[:, 2, 3]).clamp_min(0) + _GRAVITY * self.control.period**2
        offset = torch.zeros_like(pose[:, :3, 3])
        offset[:, 2] = -torch.minimum(drop, room.clamp_min(0))
        return make_pose(pose[:, :3, :3], pose[:, :3, 3] + offset)

    @staticmethod
    def _support(state: RigidState, k: int, points: Tensor) -> Tensor:
        """Height (B,) of the highest support or entity below an object's points (B, n, 3)."""
        lowest = points[..., 2].amin(1)
        height = points.new_full((len(points),), state.layout.floor)  # however deep it was pushed
        boxes = [_box(support, points) for support in state.layout.supports]
        others = [e.name for i, e in enumerate(state.layout) if i != k and not e.driven]
        boxes += [(state.entity(name), torch.eye(2).to(points)) for name in others]
        for other, ways in boxes:
            top = other[..., 2].amax(1)
            below = _overlap(points, other, ways) & (top <= lowest + _REACHES)
            height = torch.where(below, torch.maximum(height, top), height)
        return height


@cache
def _hanging(layout: Layout) -> JointTree:
    """What hangs on other entities and is not the robot's: it keeps its place, or its joint's position, on them."""
    attached = [i for i in layout.attached if not layout.entities[i].driven]
    return JointTree(layout, [i for i in layout.articulated if layout.entities[i].joint.parent is not None], attached)


def _box(support: Support, like: Tensor) -> tuple[Tensor, Tensor]:
    """Corners (1, 8, 3) of a support, and horizontal axes (K, 2): the base's and normals of its edges from above."""
    pose = matrix_from_pose7(like.new_tensor([support.origin]))
    signs = torch.cartesian_prod(*[like.new_tensor([-1.0, 1.0])] * 3)
    x, y = pose[0, :2, :3]
    normals = torch.stack([-y, x], -1)
    ways = torch.cat([torch.eye(2).to(like), normals[normals.norm(dim=-1) > _UPRIGHT]])
    return transform(pose, signs * like.new_tensor(support.half)), ways


def _overlap(points: Tensor, other: Tensor, ways: Tensor) -> Tensor:
    """Whether (B,) points (B, n, 3) and others (B, m, 3) overlap along each of the horizontal axes (K, 2)."""
    mine, theirs = points[..., :2] @ ways.T, other[..., :2] @ ways.T
    return ((mine.amin(1) < theirs.amax(1)) & (mine.amax(1) > theirs.amin(1))).all(-1)


class Commanded(LinearBaseline):
    """The hands reach each command at once; the rest as in :class:`LinearBaseline`."""

    def _hand_steps(self, links: Tensor, action: Tensor) -> Tensor:
        steps = []
        for hand in self.response.hands:
            arm = next((a.name for a in self.control.arms if a.hand == self.links.names[hand]), "")
            parts = [self.control.channel(arm, "translation"), self.control.channel(arm, "rotation")]
            told = [c.unit * action[:, c.slice] if c else action.new_zeros(len(action), 3) for c in parts]
            if yaw := self.control.channel(arm, "yaw"):
                told[1] = F.pad(yaw.unit * action[:, yaw.slice], (2, 0))
            steps.append(torch.cat(told, 1))
        return torch.stack(steps, 1) if steps else action.new_zeros(len(action), 0, 6)

    def _joints(self, positions: Tensor, action: Tensor) -> Tensor:
        tree, moved = self.response.tree, list(super()._joints(positions, action).unbind(-1))
        for k, place in enumerate(tree.moving):
            if (gripper := self._gripper(self.links.entities[place])) is not None:
                share = 0.5 * (action[:, gripper.start] + 1.0)
                moved[k] = tree.lower[k] + share * (tree.upper[k] - tree.lower[k])
        return torch.stack(moved, -1) if moved else positions[:, 0]

    def _gripper(self, link: Entity) -> Channel | None:
        """The gripper that a link belongs to: that of the arm whose hand it hangs on, or of no arm in particular."""
        while link.joint.parent is not None:
            link = self.links[link.joint.parent]
        arm = next((a.name for a in self.control.arms if a.hand == link.name), "")
        return self.control.channel(arm, "gripper") or self.control.channel("", "gripper")
