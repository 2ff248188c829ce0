"""Coffee as a ManiSkill task: put the pod into the machine's holder and shut the lid."""

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

from pwm_gym.sim.coffee_machine import (
    HOLDER_FLOOR,
    LID,
    LID_JOINT,
    MACHINE,
    OPEN_ANGLE,
    POD,
    POD_HEIGHT,
)
from pwm_gym.sim.maniskill.build import add_shapes
from pwm_gym.sim.maniskill.scenes.common import ROBOT_BASE, about_z, nearness, render_camera, sensor_camera

__all__ = ["CoffeeEnv"]

_MACHINE = (-0.03, 0.11)  # its holder, in the plane
_MACHINE_SPREAD = (0.02, 0.02, 0.10)  # x, y and yaw, to either side
_POD_FROM, _POD_TO = (-0.13, -0.24), (0.03, -0.09)  # corners of where it stands
_POD_FRICTION, _MACHINE_FRICTION, _LID_DAMPING = 0.5, 0.3, 0.004
_SEATED = (0.006, 0.008)  # the pod's distance from the holder's axis, and its bottom's from the holder's floor
_SHUT = np.radians(5.0)
_STATIC = 0.2  # rad/s
_WHOLE = 6.0  # the reward at success
_GREY, _WHITE, _BROWN = (0.3, 0.3, 0.32, 1.0), (0.85, 0.85, 0.85, 1.0), (0.35, 0.2, 0.1, 1.0)


@register_env("Coffee-v1", max_episode_steps=300)
class CoffeeEnv(BaseEnv):
    """Put a pod into a coffee machine's holder, whose funnel leaves 3 mm around it, and shut the lid.

    **Randomizations**

    - the pod stands anywhere in 16 x 15 cm beside the machine, in any yaw
    - the machine's place by 2 cm to either side, and its yaw by 0.1 rad

    **Success**: the pod is in the holder, not grasped; the lid is shut to 5 degrees; the robot is static.
    """

    SUPPORTED_ROBOTS = ["panda", "panda_wristcam"]  # noqa: RUF012

    def __init__(
        self, *args: Any, robot_uids: str = "panda", robot_init_qpos_noise: float = 0.02, **kwargs: Any
    ) -> None:
        self.robot_init_qpos_noise = robot_init_qpos_noise
        super().__init__(*args, robot_uids=robot_uids, **kwargs)

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
        self.machine = self._build_machine()
        self.body, self.lid = (self.machine.links_map[name] for name in ("machine", "lid"))
        builder = self.scene.create_actor_builder()
        rubbing = sapien.physx.PhysxMaterial(_POD_FRICTION, _POD_FRICTION, 0.0)
        add_shapes(builder, POD, _BROWN, density=500.0, material=rubbing)
        builder.initial_pose = sapien.Pose([*_POD_FROM, 0.5 * POD_HEIGHT])
        self.pod = builder.build(name="pod")

    def _build_machine(self) -> Any:
        smooth = sapien.physx.PhysxMaterial(_MACHINE_FRICTION, _MACHINE_FRICTION, 0.0)
        builder = self.scene.create_articulation_builder()
        machine = builder.create_link_builder()
        machine.set_name("machine")
        add_shapes(machine, MACHINE, _GREY, material=smooth)
        lid = builder.create_link_builder(machine)
        lid.set_name("lid")
        lid.set_joint_name("hinge")
        to_axis = [0.5**0.5, 0.0, 0.0, -(0.5**0.5)]  # SAPIEN's joints turn about x: here the lid's -y
        limits = [[LID_JOINT.lower, LID_JOINT.upper]]
        origin, own = sapien.Pose(LID_JOINT.origin[:3], to_axis), sapien.Pose(q=to_axis)
        lid.set_joint_properties("revolute", limits, origin, own, damping=_LID_DAMPING)
        add_shapes(lid, LID, _WHITE, density=400.0, material=smooth)
        builder.initial_pose = sapien.Pose([*_MACHINE, 0.0], [0.0, 0.0, 0.0, 1.0])
        built = builder.build(name="machine", fix_root_link=True)
        built.active_joints[0].set_friction(0.0)
        return built

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        with torch.device(self.device):
            count = len(env_idx)
            self.table_scene.initialize(env_idx)
            spread = (2 * torch.rand((count, 3)) - 1) * torch.tensor(_MACHINE_SPREAD)
            places = torch.tensor([*_MACHINE, 0.0]).repeat(count, 1)
            places[:, :2] += spread[:, :2]
            self.machine.set_pose(Pose.create_from_pq(places, about_z(np.pi + spread[:, 2])))
            self.machine.set_qpos(torch.full((count, 1), OPEN_ANGLE))
            self.machine.set_qvel(torch.zeros((count, 1)))
            low, high = torch.tensor(_POD_FROM), torch.tensor(_POD_TO)
            stand = torch.cat(
                [low + torch.rand((count, 2)) * (high - low), torch.full((count, 1), 0.5 * POD_HEIGHT)], -1
            )
            self.pod.set_pose(Pose.create_from_pq(stand, about_z(2 * np.pi * torch.rand(count))))

    def _place(self) -> torch.Tensor:
        """Where (B, 3) the pod's middle belongs."""
        return (self.body.pose * sapien.Pose([0.0, 0.0, HOLDER_FLOOR + 0.5 * POD_HEIGHT])).p

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Whether the pod is in the holder, the lid's angle, and success."""
        offset = self.pod.pose.p - self._place()
        seated = (torch.linalg.norm(offset[:, :2], dim=-1) <= _SEATED[0]) & (offset[:, 2] <= _SEATED[1])
        angle = self.machine.qpos[:, 0]
        grasped = self.agent.is_grasping(self.pod)
        static = self.agent.is_static(_STATIC)
        return {
            "success": seated & (angle <= _SHUT) & ~grasped & static,
            "is_grasped": grasped,
            "is_pod_seated": seated,
            "is_robot_static": static,
            "angle": angle,
        }

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, torch.Tensor]:
        found = {"tcp_pose": self.agent.tcp_pose.raw_pose, "is_grasped": info["is_grasped"]}
        if "state" in self.obs_mode:
            found["machine_pose"] = self.body.pose.raw_pose
            found["angle"] = info["angle"]
            found["pod_pose"] = self.pod.pose.raw_pose
        return found

    def compute_dense_reward(self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]) -> torch.Tensor:
        """Shaped reward (B,) from 0 to 6: put the pod in (to 3), let it go and shut the lid (to 5), success."""
        held = info["is_grasped"].float()
        reach = nearness(self.agent.tcp_pos, self.pod.pose.p)
        reward = reach + held * (1.0 + nearness(self.pod.pose.p, self._place()))
        shut = 1.0 - (info["angle"] / OPEN_ANGLE).clamp(0.0, 1.0)
        reward = torch.where(info["is_pod_seated"], 3.0 + (1.0 - held) * (0.5 + 1.5 * shut), reward)
        return torch.where(info["success"], _WHOLE, reward)

    def compute_normalized_dense_reward(
        self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]
    ) -> torch.Tensor:
        """The shaped reward (B,) in [0, 1]."""
        return self.compute_dense_reward(obs=obs, action=action, info=info) / _WHOLE
