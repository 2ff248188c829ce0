"""Coffee as a ManiSkill task: put the pod into the machine's holder and shut the lid."""

from __future__ import annotations

from typing import Any

import sapien
import torch
from mani_skill.utils.registration import register_env

from pwm_gym.sim.coffee_machine import HOLDER_FLOOR, OPEN_ANGLE, POD_HEIGHT, SEATED, SHUT_ANGLE
from pwm_gym.sim.maniskill.scenes.common import TableEnv, nearness
from pwm_gym.sim.maniskill.scenes.parts import build_machine, build_pod, put_articulation, random_places

__all__ = ["CoffeeEnv"]

_MACHINE = (-0.03, 0.11)  # its holder, in the plane
_MACHINE_SPREAD = (0.02, 0.02, 0.10)  # x, y and yaw, to either side
_POD_FROM, _POD_TO = (-0.13, -0.24), (0.03, -0.09)  # corners of where it stands
_STATIC = 0.2  # rad/s


@register_env("Coffee-v1", max_episode_steps=300)
class CoffeeEnv(TableEnv):
    """Put a pod into a coffee machine's holder, whose funnel leaves 3 mm around it, and shut the lid.

    **Randomizations**

    - the pod stands anywhere in 16 x 15 cm beside the machine, in any yaw
    - the machine's place by 2 cm to either side, and its yaw by 0.1 rad

    **Success**: the pod is in the holder, not grasped; the lid is shut to 5 degrees; the robot is static.
    """

    whole = 6.0

    def _load_scene(self, options: dict[str, Any]) -> None:
        super()._load_scene(options)
        self.machine = build_machine(self.scene, _MACHINE)
        self.body, self.lid = (self.machine.links_map[name] for name in ("machine", "lid"))
        self.pod = build_pod(self.scene, _POD_FROM)

    def _place_objects(self, env_idx: torch.Tensor) -> None:
        count = len(env_idx)
        put_articulation(self.machine, (*_MACHINE, 0.0), _MACHINE_SPREAD, OPEN_ANGLE, count)
        self.pod.set_pose(random_places(_POD_FROM, _POD_TO, torch.full((count,), 0.5 * POD_HEIGHT)))

    def _place(self) -> torch.Tensor:
        """Where (B, 3) the pod's middle belongs."""
        return (self.body.pose * sapien.Pose([0.0, 0.0, HOLDER_FLOOR + 0.5 * POD_HEIGHT])).p

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Whether the pod is in the holder, the lid's angle, and success."""
        offset = self.pod.pose.p - self._place()
        seated = (torch.linalg.norm(offset[:, :2], dim=-1) <= SEATED[0]) & (offset[:, 2] <= SEATED[1])
        angle = self.machine.qpos[:, 0]
        grasped = self.agent.is_grasping(self.pod)
        static = self.agent.is_static(_STATIC)
        return {
            "success": seated & (angle <= SHUT_ANGLE) & ~grasped & static,
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
        return torch.where(info["success"], self.whole, reward)
