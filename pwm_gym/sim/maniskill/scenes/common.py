"""What our own ManiSkill tasks share: a Panda at a table, two cameras, mugs of many sizes, and small tensors."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils import sapien_utils
from mani_skill.utils.scene_builder.table import TableSceneBuilder

from pwm_gym.robots.two_hands import JOINT_NAMES, TOOL
from pwm_gym.sim.maniskill import two_hands  # noqa: F401  (registers the robot)
from pwm_gym.sim.mugs import MUGS

__all__ = ["MugTableEnv", "TableEnv", "TwoHandsTableEnv", "about_z", "native_pose", "nearness"]


class TableEnv(BaseEnv):
    """A Panda at a table, seen by one camera; a subclass builds what stands on it."""

    SUPPORTED_ROBOTS: ClassVar[list[str]] = ["panda", "panda_wristcam"]
    base: ClassVar[sapien.Pose] = sapien.Pose([-0.615, 0.0, 0.0])
    """Of the robot; as in ManiSkill's tasks on a table."""
    whole: ClassVar[float]
    """The shaped reward at success."""

    def __init__(
        self, *args: Any, robot_uids: str = "panda", robot_init_qpos_noise: float = 0.02, **kwargs: Any
    ) -> None:
        self.robot_init_qpos_noise = robot_init_qpos_noise
        super().__init__(*args, robot_uids=robot_uids, **kwargs)

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        pose = sapien_utils.look_at(eye=[-0.3, -0.5, 0.6], target=[0.05, 0.0, 0.05])  # beside the robot
        return [CameraConfig("base_camera", pose, 128, 128, np.pi / 2, 0.01, 100)]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        pose = sapien_utils.look_at([-0.4, -0.7, 0.7], [0.05, 0.0, 0.1])
        return CameraConfig("render_camera", pose, 512, 512, 1, 0.01, 100)

    def _load_agent(self, options: dict[str, Any]) -> None:
        super()._load_agent(options, self.base)

    def _load_scene(self, options: dict[str, Any]) -> None:
        self.table_scene = TableSceneBuilder(self, robot_init_qpos_noise=self.robot_init_qpos_noise)
        self.table_scene.build()

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        with torch.device(self.device):
            self.table_scene.initialize(env_idx)
            self._place_objects(env_idx)

    def _place_objects(self, env_idx: torch.Tensor) -> None:
        """Put what stands on the table where the episodes of some environments begin."""
        raise NotImplementedError

    def compute_normalized_dense_reward(
        self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]
    ) -> torch.Tensor:
        """The shaped reward (B,) in [0, 1]."""
        return self.compute_dense_reward(obs=obs, action=action, info=info) / self.whole


class MugTableEnv(TableEnv):
    """A table with a mug, whose size is drawn when the scene is built."""

    def __init__(self, *args: Any, num_envs: int = 1, reconfiguration_freq: int | None = None, **kwargs: Any) -> None:
        self.mug_choice = tuple(MUGS)  # what the next scene's mugs are drawn from
        self.mug_names: tuple[str, ...] = ()  # of the present scene, one an environment
        if reconfiguration_freq is None:
            reconfiguration_freq = 1 if num_envs == 1 else 0
        super().__init__(*args, num_envs=num_envs, reconfiguration_freq=reconfiguration_freq, **kwargs)

    def _load_scene(self, options: dict[str, Any]) -> None:
        super()._load_scene(options)
        self.mug_names = tuple(map(str, self._batched_episode_rng.choice(self.mug_choice)))
        self.mug_half = torch.tensor([0.5 * MUGS[name].height for name in self.mug_names], device=self.device)


class TwoHandsTableEnv(TableEnv):
    """Two arms with hands at a table, in one environment on the CPU."""

    SUPPORTED_ROBOTS: ClassVar[list[str]] = ["two_hands"]
    base = sapien.Pose([-0.43, 0.0, 0.0])

    def __init__(self, *args: Any, robot_uids: str = "two_hands", num_envs: int = 1, **kwargs: Any) -> None:
        super().__init__(*args, robot_uids=robot_uids, num_envs=num_envs, **kwargs)

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        arms = self.agent.rest(self._episode_rng.normal(0.0, self.robot_init_qpos_noise, len(JOINT_NAMES)))
        self.agent.reset(torch.as_tensor(arms, dtype=torch.float32)[None])
        self.agent.robot.set_pose(self.base)
        super()._initialize_episode(env_idx, options)

    def tool(self, side: str) -> sapien.Pose:
        """Tool centre of one hand."""
        return native_pose(self.agent.robot.links_map[f"{side}_palm"]) * sapien.Pose(TOOL)


def nearness(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """1 where points (B, 3) coincide, falling with their distance: (B,)."""
    return 1.0 - torch.tanh(5.0 * torch.linalg.norm(a - b, dim=-1))


def native_pose(struct: Any) -> sapien.Pose:
    """SAPIEN's pose of a link or an actor of one environment: 25 times faster to read than ManiSkill's tensors."""
    native = struct._objs[0]
    return (native.entity if hasattr(native, "entity") else native).pose


def about_z(angle: torch.Tensor) -> torch.Tensor:
    """Quaternions (B, 4) of turns (B,) about the vertical."""
    zero = torch.zeros_like(angle)
    return torch.stack([torch.cos(0.5 * angle), zero, zero, torch.sin(0.5 * angle)], -1)
