"""World models without learning: what any learned one has to beat.

``still``: nothing moves. ``commanded``: the end effector goes where it is told at once. ``linear``: it follows its
fitted linear response, a grasped object is attached to it, and a released one falls to its support.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.response import LinearResponse
from pwm_gym.robots import Control
from pwm_gym.scene import Layout, RigidState, State
from pwm_gym.scene.se3 import inverse, make_pose, rotation_from_vector, transform

__all__ = ["BaselineConfig", "Commanded", "LinearBaseline", "Still"]

_GRAVITY = 9.81


@dataclass(frozen=True)
class BaselineConfig:
    """The controller's units and the grasp rule."""

    position_unit: float = 0.1
    """Metres per unit of translation."""
    rotation_unit: float = -0.1
    """Radians per unit of rotation."""
    reach: float = 0.025
    """Metres between the tool centre and the object's within which a shut gripper holds it (paper, appendix)."""
    time_step: float = 0.05
    """Seconds per control step."""


class Still(nn.Module):
    """Nothing moves."""

    def __init__(
        self,
        layout: Layout,
        action_size: int,
        control: Control | None = None,
        config: BaselineConfig | None = None,
    ) -> None:
        super().__init__()
        self.layout, self.action_size, self.config = layout, action_size, config or BaselineConfig()
        self.control = control or Control()

    def prepare(self, state: State) -> State:
        """Entity poses of ``state``."""
        return RigidState(state.layout, state.clouds, state.history())

    def step(self, state: State, action: Tensor) -> State:
        """The same poses again."""
        assert isinstance(state, RigidState)
        return state.advance(state.poses())


class LinearBaseline(Still):
    """The end effector's linear response; objects attach and detach by the grasp rule and fall when let go."""

    def __init__(
        self,
        layout: Layout,
        action_size: int,
        control: Control | None = None,
        config: BaselineConfig | None = None,
    ) -> None:
        super().__init__(layout, action_size, control, config)
        self.response = LinearResponse(layout, action_size)
        self._free = [i for i, e in enumerate(layout) if not e.driven]

    def step(self, state: State, action: Tensor) -> State:
        """State (B,) one step later."""
        assert isinstance(state, RigidState)
        effector, now = self.response.effector, state.poses()
        root = now[:, effector.root]
        step, openings = self._command(state, action)
        position = self.response.confine(root[:, :3, 3] + step[:, :3])
        moved_root = make_pose(rotation_from_vector(step[:, 3:]) @ root[:, :3, :3], position)
        held = {k: self._held(state, k, action) for k in self._free}
        openings = self._stop_at_object(openings, effector.openings(state.frames)[:, 0], held)
        moved = list(now.unbind(1))
        moved[effector.root] = moved_root
        for k, pose in zip(effector.sliding, effector.links(moved_root, openings).unbind(1), strict=True):
            moved[k] = pose
        for k in self._free:
            carried = moved_root @ inverse(root) @ now[:, k]
            moved[k] = torch.where(held[k][:, None, None], carried, self._fall(state, k))
        return state.advance(torch.stack(moved, 1))

    def _command(self, state: RigidState, action: Tensor) -> tuple[Tensor, Tensor]:
        """World-frame twist (B, 6) of the root link and next openings (B, S)."""
        openings = self.response.effector.openings(state.frames)
        step, slide = self.response(state.frames, openings, action)
        return step, self.response.effector.limit(openings[:, 0] + slide)

    def _held(self, state: RigidState, k: int, action: Tensor) -> Tensor:
        """Whether (B,) entity ``k`` is near the tool centre and the gripper is commanded shut."""
        names = state.layout.names
        near = (state.entity(names[k]).mean(1) - self._tool(state)).norm(dim=-1) <= self.config.reach
        return near & (action[:, -1] < 0)

    def _tool(self, state: RigidState) -> Tensor:
        """Tool centre (B, 3): the arm's own, or the centre of the links that slide."""
        effector, names = self.response.effector, state.layout.names
        if self.control.arms and self.control.arms[0].chain is not None:
            tool = state.clouds.new_tensor([self.control.arms[0].chain.tool])
            return transform(state.poses()[:, effector.root], tool).squeeze(-2)
        links = effector.sliding or [effector.root]
        return torch.stack([state.entity(names[i]).mean(1) for i in links]).mean(0)

    @staticmethod
    def _stop_at_object(openings: Tensor, before: Tensor, held: dict[int, Tensor]) -> Tensor:
        """Openings (B, S): fingers around a held object stay where they are."""
        for grasped in held.values():
            openings = torch.where(grasped.unsqueeze(-1), torch.maximum(openings, before), openings)
        return openings

    def _fall(self, state: RigidState, k: int) -> Tensor:
        """Pose (B, 4, 4) of a free object: down by gravity until its lowest point touches the table (z = 0)."""
        pose, before = state.frames[:, 0, k], state.frames[:, 1, k]
        lowest = transform(pose, state.clouds[:, state.layout.entities[k].slice])[..., 2].amin(1)
        drop = (before[:, 2, 3] - pose[:, 2, 3]).clamp_min(0) + _GRAVITY * self.config.time_step**2
        offset = torch.zeros_like(pose[:, :3, 3])
        offset[:, 2] = -torch.minimum(drop, lowest.clamp_min(0))
        return make_pose(pose[:, :3, :3], pose[:, :3, 3] + offset)


class Commanded(LinearBaseline):
    """The end effector reaches each command at once; the rest as in :class:`LinearBaseline`."""

    def _command(self, state: RigidState, action: Tensor) -> tuple[Tensor, Tensor]:
        c, effector = self.config, self.response.effector
        step = torch.cat([action[:, :3] * c.position_unit, action[:, 3:6] * c.rotation_unit], 1)
        upper = action.new_tensor(effector.uppers)
        return step, effector.limit(0.5 * (action[:, -1:] + 1) * upper)
