"""CoffeePreparation as a ManiSkill task: mug to the machine, pod out of the drawer into the holder, lid shut."""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import register_env
from mani_skill.utils.scene_builder.table import TableSceneBuilder
from mani_skill.utils.structs import Pose

from pwm_gym.sim.cabinet import CABINET_HALF, DRAWER_JOINT, HANDLE, PLACE, STROKE
from pwm_gym.sim.coffee_machine import HOLDER_FLOOR, MUG_AHEAD, OPEN_ANGLE, POD_HEIGHT
from pwm_gym.sim.maniskill.scenes.common import ROBOT_BASE, nearness, render_camera, sensor_camera
from pwm_gym.sim.maniskill.scenes.parts import (
    build_cabinet,
    build_machine,
    build_mugs,
    build_pod,
    put_articulation,
    random_places,
)
from pwm_gym.sim.mugs import MUGS

__all__ = ["CoffeePreparationEnv"]

_MACHINE, _CABINET = (-0.03, 0.18), (0.21, -0.13)  # its holder, and its middle, in the plane
_SPREAD = (0.01, 0.01, 0.05)  # x, y and yaw of both, to either side
_MUG_FROM, _MUG_TO = (-0.23, 0.0), (-0.16, 0.05)  # corners of where it stands
_POD_SPREAD = (0.012, 0.03)  # of the pod in the drawer, along x and y
_OPEN = 0.12  # from here on the pod's part of the reward counts
_MUG_BESIDE, _MUG_ABOVE = 0.02, 0.006  # the mug's axis from its place, and its bottom from the table
_SEATED = (0.006, 0.008)  # the pod's distance from the holder's axis, and its bottom's from the holder's floor
_SHUT = np.radians(5.0)
_STATIC = 0.2  # rad/s
_WHOLE = 11.0  # the reward at success


@register_env("CoffeePreparation-v1", max_episode_steps=450)
class CoffeePreparationEnv(BaseEnv):
    """Put the mug before the coffee machine, take the pod out of the drawer, put it into the holder, shut the lid.

    **Randomizations**

    - the mug is one of nine sizes (when the scene is built), anywhere in 7 x 5 cm between machine and cabinet, in any
      yaw; the pod stands in the shut drawer, 12 mm along it and 3 cm across it to either side
    - machine and cabinet by 1 cm to either side, and their yaws by 0.05 rad

    **Success**: the mug stands at its place, the pod is in the holder, neither is grasped; the lid is shut to 5
    degrees; the robot is static. The drawer may stay open.
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
        self.machine = build_machine(self.scene, _MACHINE)
        self.body, self.lid = (self.machine.links_map[name] for name in ("machine", "lid"))
        self.cabinet = build_cabinet(self.scene, _CABINET)
        self.drawer = self.cabinet.links_map["drawer"]
        self.pod = build_pod(self.scene, _CABINET)
        self.mug_names = tuple(map(str, self._batched_episode_rng.choice(self.mug_choice)))
        self.mug = build_mugs(self, self.mug_names, _MUG_FROM)
        self.mug_half = torch.tensor([0.5 * MUGS[name].height for name in self.mug_names], device=self.device)

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        with torch.device(self.device):
            count = len(env_idx)
            self.table_scene.initialize(env_idx)
            put_articulation(self.machine, (*_MACHINE, 0.0), _SPREAD, OPEN_ANGLE, count)
            put_articulation(self.cabinet, (*_CABINET, CABINET_HALF[2]), _SPREAD, 0.0, count)
            self.mug.set_pose(random_places(_MUG_FROM, _MUG_TO, self.mug_half[env_idx]))
            self.pod.set_pose(self.cabinet.pose * Pose.create_from_pq(self._in_tray(count)))

    def _in_tray(self, count: int) -> torch.Tensor:
        """Where (B, 3) pods stand in shut drawers, in the cabinets' frames."""
        x, y, floor = PLACE
        middle = torch.tensor([x, y, floor + DRAWER_JOINT.origin[2] + 0.5 * POD_HEIGHT])
        return middle + (2 * torch.rand((count, 3)) - 1) * torch.tensor([*_POD_SPREAD, 0.0])

    def _seat(self) -> torch.Tensor:
        """Where (B, 3) the pod's middle belongs."""
        return (self.body.pose * sapien.Pose([0.0, 0.0, HOLDER_FLOOR + 0.5 * POD_HEIGHT])).p

    def _stand(self) -> torch.Tensor:
        """Where (B, 3) the mug's middle belongs."""
        flat = (self.body.pose * sapien.Pose([MUG_AHEAD, 0.0, 0.0])).p
        return torch.cat([flat[:, :2], self.mug_half.unsqueeze(-1)], -1)

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Whether mug and pod are at their places, how far drawer and lid are open, and success."""
        away, offset = self.mug.pose.p - self._stand(), self.pod.pose.p - self._seat()
        at_machine = (torch.linalg.norm(away[:, :2], dim=-1) <= _MUG_BESIDE) & (away[:, 2] <= _MUG_ABOVE)
        seated = (torch.linalg.norm(offset[:, :2], dim=-1) <= _SEATED[0]) & (offset[:, 2] <= _SEATED[1])
        angle = self.machine.qpos[:, 0]
        holds_mug, holds_pod = self.agent.is_grasping(self.mug), self.agent.is_grasping(self.pod)
        static = self.agent.is_static(_STATIC)
        left = ~holds_mug & ~holds_pod
        return {
            "success": at_machine & seated & (angle <= _SHUT) & left & static,
            "is_mug_grasped": holds_mug,
            "is_grasped": holds_pod,
            "is_mug_at_machine": at_machine,
            "is_pod_seated": seated,
            "is_robot_static": static,
            "opening": self.cabinet.qpos[:, 0],
            "angle": angle,
        }

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, torch.Tensor]:
        found = {"tcp_pose": self.agent.tcp_pose.raw_pose, "is_grasped": info["is_grasped"]}
        if "state" in self.obs_mode:
            found["machine_pose"] = self.body.pose.raw_pose
            found["cabinet_pose"] = self.cabinet.pose.raw_pose
            found["mug_pose"] = self.mug.pose.raw_pose
            found["pod_pose"] = self.pod.pose.raw_pose
            found["opening"], found["angle"] = info["opening"], info["angle"]
        return found

    def compute_dense_reward(self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]) -> torch.Tensor:
        """Shaped reward (B,) from 0 to 11: mug to the machine (to 3), drawer open (to 5), pod in (to 8), lid shut (to
        10), success.
        """
        tool = self.agent.tcp_pos
        held = info["is_mug_grasped"].float()
        mug, pod = self.mug.pose.p, self.pod.pose.p
        reward = nearness(tool, mug) + held * (1.0 + nearness(mug, self._stand()))

        handle = (self.drawer.pose * sapien.Pose(HANDLE)).p
        opened = (info["opening"] / STROKE).clamp(0.0, 1.0)
        stands = info["is_mug_at_machine"]
        reward = torch.where(stands, 3.0 + (1.0 - held) * (nearness(tool, handle) + opened), reward)

        held = info["is_grasped"].float()
        put_in = 5.0 + nearness(tool, pod) + held * (1.0 + nearness(pod, self._seat()))
        reward = torch.where(stands & (info["opening"] >= _OPEN), put_in, reward)

        shut = 1.0 - (info["angle"] / OPEN_ANGLE).clamp(0.0, 1.0)
        shutting = 8.0 + (1.0 - held) * (0.5 + 1.5 * shut)
        reward = torch.where(stands & info["is_pod_seated"], shutting, reward)
        return torch.where(info["success"], _WHOLE, reward)

    def compute_normalized_dense_reward(
        self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]
    ) -> torch.Tensor:
        """The shaped reward (B,) in [0, 1]."""
        return self.compute_dense_reward(obs=obs, action=action, info=info) / _WHOLE
