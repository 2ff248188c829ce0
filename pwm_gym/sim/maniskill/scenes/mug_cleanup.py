"""MugCleanup as a ManiSkill task: open the drawer, put the mug into it, shut the drawer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sapien
import torch
from mani_skill.utils.registration import register_env

from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.sim.maniskill.scenes.common import MugTableEnv, nearness
from pwm_gym.sim.maniskill.scenes.parts import build_cabinet, build_mugs, put_articulation, random_places
from pwm_gym.sim.mugs import MUGS, get_mug

__all__ = ["MugChoice", "MugCleanupEnv"]

_CABINET = (0.21, 0.15)  # middle, in the plane
_CABINET_SPREAD = (0.015, 0.015, 0.08)  # x, y and yaw, to either side
_MUG_FROM, _MUG_TO = (-0.13, -0.26), (0.0, -0.15)  # corners of where it stands
_SHUT = 0.008
_IN_TRAY = 0.014  # of the mug's bottom over the tray's floor
_EDGE = 0.025  # by which the mug's axis is further in than the tray's walls
_STATIC = 0.2  # rad/s


@register_env("MugCleanup-v1", max_episode_steps=400)
class MugCleanupEnv(MugTableEnv):
    """Open a cabinet's drawer by its handle, put the mug into it and push it shut.

    **Randomizations**

    - the mug is one of nine sizes (when the scene is built), anywhere in 13 x 11 cm beside the cabinet, in any yaw
    - the cabinet's place by 1.5 cm to either side, and its yaw by 0.08 rad

    **Success**: the mug lies in the drawer, not grasped; the drawer is shut to 8 mm; the robot is static.
    """

    whole = 8.0

    def _load_scene(self, options: dict[str, Any]) -> None:
        super()._load_scene(options)
        self.cabinet = build_cabinet(self.scene, _CABINET)
        self.drawer = self.cabinet.links_map["drawer"]
        self.mug = build_mugs(self, self.mug_names, _MUG_FROM)

    def _place_objects(self, env_idx: torch.Tensor) -> None:
        place = (*_CABINET, LOW_CABINET.half[2])
        put_articulation(self.cabinet, place, _CABINET_SPREAD, 0.0, len(env_idx))
        self.mug.set_pose(random_places(_MUG_FROM, _MUG_TO, self.mug_half[env_idx]))

    def _in_drawer(self, point: tuple[float, float, float]) -> torch.Tensor:
        """Place (B, 3) of a point of the drawer's frame."""
        return (self.drawer.pose * sapien.Pose(point)).p

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Whether the mug is in the drawer, how far this is open, and success."""
        offset = (self.drawer.pose.inv() * self.mug.pose).p  # (B, 3), in the drawer's frame
        low, high = torch.tensor(LOW_CABINET.tray, device=self.device)
        within = ((offset[:, :2] >= low + _EDGE) & (offset[:, :2] <= high - _EDGE)).all(-1)
        inside = within & (offset[:, 2] - self.mug_half - LOW_CABINET.tray_floor <= _IN_TRAY)
        opening = self.cabinet.qpos[:, 0]
        grasped = self.agent.is_grasping(self.mug)
        static = self.agent.is_static(_STATIC)
        return {
            "success": inside & (opening <= _SHUT) & ~grasped & static,
            "is_grasped": grasped,
            "is_mug_inside": inside,
            "is_robot_static": static,
            "opening": opening,
        }

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, torch.Tensor]:
        found = {"tcp_pose": self.agent.tcp_pose.raw_pose, "is_grasped": info["is_grasped"]}
        if "state" in self.obs_mode:
            found["cabinet_pose"] = self.cabinet.pose.raw_pose
            found["opening"] = info["opening"]
            found["mug_pose"] = self.mug.pose.raw_pose
        return found

    def compute_dense_reward(self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]) -> torch.Tensor:
        """Shaped reward (B,) from 0 to 8: open (to 2), put the mug in (to 5), shut (to 7), success."""
        tool = self.agent.tcp_pos
        reach_handle = nearness(tool, self._in_drawer(LOW_CABINET.handle))
        opened = (info["opening"] / LOW_CABINET.stroke).clamp(0.0, 1.0)
        reward = reach_handle + opened

        held = info["is_grasped"].float()
        raised = torch.stack([0 * self.mug_half, 0 * self.mug_half, self.mug_half], -1)
        place = self._in_drawer(LOW_CABINET.place) + raised
        put_in = 2.0 + nearness(tool, self.mug.pose.p) + held * (1.0 + nearness(self.mug.pose.p, place))
        reward = torch.where(info["opening"] >= LOW_CABINET.opened, put_in, reward)

        shut = 5.0 + (1.0 - held) * (0.5 + 0.5 * reach_handle + 1.0 - opened)
        reward = torch.where(info["is_mug_inside"], shut, reward)
        return torch.where(info["success"], self.whole, reward)


class MugChoice:
    """The mug of MugCleanup's scenes; a :class:`pwm_gym.sim.maniskill.AssetChoice`."""

    entity = "mug"

    def force(self, env: Any, assets: Mapping[str, str] | None) -> None:
        """Make the next scene of this mug, or of one that the seed draws.

        Raises:
            UnknownNameError: there is no such mug.
        """
        if assets is not None:
            get_mug(assets[self.entity])
        env.mug_choice = tuple(MUGS) if assets is None else (assets[self.entity],)

    def names(self, env: Any) -> Mapping[str, str]:
        """The mug's name."""
        return {self.entity: env.mug_names[0]}

    @staticmethod
    def actor(env: Any) -> Any:
        """The mug's actor."""
        return env.mug
