"""MugCleanup as a ManiSkill task: open the drawer, put the mug into it, shut the drawer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import register_env
from mani_skill.utils.scene_builder.table import TableSceneBuilder
from mani_skill.utils.structs import Actor, Pose

from pwm_gym.sim.cabinet import CABINET, CABINET_HALF, DRAWER, DRAWER_JOINT, HANDLE, PLACE, STROKE, TRAY, TRAY_FLOOR
from pwm_gym.sim.maniskill.build import add_shapes
from pwm_gym.sim.maniskill.scenes.common import ROBOT_BASE, about_z, nearness, render_camera, sensor_camera
from pwm_gym.sim.mugs import MUGS, get_mug

__all__ = ["MugChoice", "MugCleanupEnv"]

_CABINET = (0.21, 0.15)  # middle, in the plane
_CABINET_SPREAD = (0.015, 0.015, 0.08)  # x, y and yaw, to either side
_MUG_FROM, _MUG_TO = (-0.13, -0.26), (0.0, -0.15)  # corners of where it stands
_FRICTION, _DAMPING = 1.0, 20.0  # of the drawer, which stays where it is left
_OPEN = 0.12  # from here on the mug's part of the reward counts
_SHUT = 0.008
_IN_TRAY = 0.014  # of the mug's bottom over the tray's floor
_EDGE = 0.025  # by which the mug's axis is further in than the tray's walls
_STATIC = 0.2  # rad/s
_WHOLE = 8.0  # the reward at success
_WOOD, _RED = (0.55, 0.40, 0.26, 1.0), (0.75, 0.15, 0.12, 1.0)


@register_env("MugCleanup-v1", max_episode_steps=400)
class MugCleanupEnv(BaseEnv):
    """Open a cabinet's drawer by its handle, put the mug into it and push it shut.

    **Randomizations**

    - the mug is one of nine sizes (when the scene is built), anywhere in 13 x 11 cm beside the cabinet, in any yaw
    - the cabinet's place by 1.5 cm to either side, and its yaw by 0.08 rad

    **Success**: the mug lies in the drawer, not grasped; the drawer is shut to 8 mm; the robot is static.
    """

    SUPPORTED_ROBOTS = ["panda", "panda_wristcam"]  # noqa: RUF012

    def __init__(
        self,
        *args: Any,
        robot_uids: str = "panda",
        num_envs: int = 1,
        robot_init_qpos_noise: float = 0.02,
        reconfiguration_freq: int | None = None,
        **kwargs: Any,
    ) -> None:
        self.robot_init_qpos_noise = robot_init_qpos_noise
        self.mug_choice = tuple(MUGS)  # what the next scene's mugs are drawn from
        self.mug_names: tuple[str, ...] = ()  # of the present scene, one an environment
        if reconfiguration_freq is None:
            reconfiguration_freq = 1 if num_envs == 1 else 0
        super().__init__(
            *args,
            robot_uids=robot_uids,
            num_envs=num_envs,
            reconfiguration_freq=reconfiguration_freq,
            **kwargs,
        )

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        return [sensor_camera()]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        return render_camera()

    def _load_agent(self, options: dict[str, Any]) -> None:
        super()._load_agent(options, ROBOT_BASE)

    def _load_scene(self, options: dict[str, Any]) -> None:
        self.table_scene = TableSceneBuilder(self, robot_init_qpos_noise=self.robot_init_qpos_noise)
        self.table_scene.build()
        self.cabinet = self._build_cabinet()
        self.drawer = self.cabinet.links_map["drawer"]
        self.mug_names = tuple(map(str, self._batched_episode_rng.choice(self.mug_choice)))
        self.mug = self._build_mugs()
        self.mug_half = torch.tensor([0.5 * MUGS[name].height for name in self.mug_names], device=self.device)

    def _build_cabinet(self) -> Any:
        builder = self.scene.create_articulation_builder()
        cabinet = builder.create_link_builder()
        cabinet.set_name("cabinet")
        add_shapes(cabinet, CABINET, _WOOD)
        drawer = builder.create_link_builder(cabinet)
        drawer.set_name("drawer")
        drawer.set_joint_name("slide")
        origin = sapien.Pose(DRAWER_JOINT.origin[:3])  # SAPIEN's joints slide along x, as this one does
        limits = [[DRAWER_JOINT.lower, DRAWER_JOINT.upper]]
        drawer.set_joint_properties("prismatic", limits, origin, sapien.Pose(), damping=_DAMPING)
        add_shapes(drawer, DRAWER, _WOOD, density=400.0)
        builder.initial_pose = sapien.Pose([*_CABINET, CABINET_HALF[2]], [0.0, 0.0, 0.0, 1.0])
        built = builder.build(name="cabinet", fix_root_link=True)
        built.active_joints[0].set_friction(_FRICTION)
        return built

    def _build_mugs(self) -> Any:
        mugs = []
        for i, name in enumerate(self.mug_names):
            builder = self.scene.create_actor_builder()
            add_shapes(builder, MUGS[name].shapes(), _RED, density=600.0)
            builder.initial_pose = sapien.Pose([*_MUG_FROM, 0.5 * MUGS[name].height])
            builder.set_scene_idxs([i])
            mugs.append(builder.build(name=f"{name}-{i}"))
            self.remove_from_state_dict_registry(mugs[-1])
        mug = Actor.merge(mugs, name="mug")
        self.add_to_state_dict_registry(mug)
        return mug

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        with torch.device(self.device):
            count = len(env_idx)
            self.table_scene.initialize(env_idx)
            spread = (2 * torch.rand((count, 3)) - 1) * torch.tensor(_CABINET_SPREAD)
            places = torch.tensor([*_CABINET, CABINET_HALF[2]]).repeat(count, 1)
            places[:, :2] += spread[:, :2]
            self.cabinet.set_pose(Pose.create_from_pq(places, about_z(np.pi + spread[:, 2])))
            self.cabinet.set_qpos(torch.zeros((count, 1)))
            self.cabinet.set_qvel(torch.zeros((count, 1)))
            low, high = torch.tensor(_MUG_FROM), torch.tensor(_MUG_TO)
            stand = torch.cat([low + torch.rand((count, 2)) * (high - low), self.mug_half[env_idx, None]], -1)
            self.mug.set_pose(Pose.create_from_pq(stand, about_z(2 * np.pi * torch.rand(count))))

    def _in_drawer(self, point: tuple[float, float, float]) -> torch.Tensor:
        """Place (B, 3) of a point of the drawer's frame."""
        return (self.drawer.pose * sapien.Pose(point)).p

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Whether the mug is in the drawer, how far this is open, and success."""
        offset = (self.drawer.pose.inv() * self.mug.pose).p  # (B, 3), in the drawer's frame
        low, high = torch.tensor(TRAY, device=self.device)
        within = ((offset[:, :2] >= low + _EDGE) & (offset[:, :2] <= high - _EDGE)).all(-1)
        inside = within & (offset[:, 2] - self.mug_half - TRAY_FLOOR <= _IN_TRAY)
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
        reach_handle = nearness(tool, self._in_drawer(HANDLE))
        opened = (info["opening"] / STROKE).clamp(0.0, 1.0)
        reward = reach_handle + opened

        held = info["is_grasped"].float()
        place = self._in_drawer(PLACE) + torch.stack([0 * self.mug_half, 0 * self.mug_half, self.mug_half], -1)
        put_in = 2.0 + nearness(tool, self.mug.pose.p) + held * (1.0 + nearness(self.mug.pose.p, place))
        reward = torch.where(info["opening"] >= _OPEN, put_in, reward)

        shut = 5.0 + (1.0 - held) * (0.5 + 0.5 * reach_handle + 1.0 - opened)
        reward = torch.where(info["is_mug_inside"], shut, reward)
        return torch.where(info["success"], _WHOLE, reward)

    def compute_normalized_dense_reward(
        self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]
    ) -> torch.Tensor:
        """The shaped reward (B,) in [0, 1]."""
        return self.compute_dense_reward(obs=obs, action=action, info=info) / _WHOLE


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
