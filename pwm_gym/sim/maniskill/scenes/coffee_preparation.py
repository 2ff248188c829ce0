"""CoffeePreparation as a ManiSkill task: mug to the machine, pod out of the drawer into the holder, lid shut."""

from __future__ import annotations

from typing import Any

import sapien
import torch
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs import Pose

from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.sim.coffee_machine import HOLDER_FLOOR, MUG_AHEAD, OPEN_ANGLE, POD_HEIGHT, SEATED, SHUT_ANGLE
from pwm_gym.sim.maniskill.scenes.common import MugTableEnv, nearness
from pwm_gym.sim.maniskill.scenes.parts import (
    build_cabinet,
    build_machine,
    build_mugs,
    build_pod,
    put_articulation,
    random_places,
)

__all__ = ["CoffeePreparationEnv"]

_MACHINE, _CABINET = (-0.03, 0.18), (0.21, -0.13)  # its holder, and its middle, in the plane
_SPREAD = (0.01, 0.01, 0.05)  # x, y and yaw of both, to either side
_MUG_FROM, _MUG_TO = (-0.23, 0.0), (-0.16, 0.05)  # corners of where it stands
_POD_SPREAD = (0.012, 0.03)  # of the pod in the drawer, along x and y
_MUG_BESIDE, _MUG_ABOVE = 0.02, 0.006  # the mug's axis from its place, and its bottom from the table
_STATIC = 0.2  # rad/s


@register_env("CoffeePreparation-v1", max_episode_steps=450)
class CoffeePreparationEnv(MugTableEnv):
    """Put the mug before the coffee machine, take the pod out of the drawer, put it into the holder, shut the lid.

    **Randomizations**

    - the mug is one of nine sizes (when the scene is built), anywhere in 7 x 5 cm between machine and cabinet, in any
      yaw; the pod stands in the shut drawer, 12 mm along it and 3 cm across it to either side
    - machine and cabinet by 1 cm to either side, and their yaws by 0.05 rad

    **Success**: the mug stands at its place, the pod is in the holder, neither is grasped; the lid is shut to 5
    degrees; the robot is static. The drawer may stay open.
    """

    whole = 11.0

    def _load_scene(self, options: dict[str, Any]) -> None:
        super()._load_scene(options)
        self.machine = build_machine(self.scene, _MACHINE)
        self.body, self.lid = (self.machine.links_map[name] for name in ("machine", "lid"))
        self.cabinet = build_cabinet(self.scene, _CABINET)
        self.drawer = self.cabinet.links_map["drawer"]
        self.pod = build_pod(self.scene, _CABINET)
        self.mug = build_mugs(self, self.mug_names, _MUG_FROM)

    def _place_objects(self, env_idx: torch.Tensor) -> None:
        count = len(env_idx)
        put_articulation(self.machine, (*_MACHINE, 0.0), _SPREAD, OPEN_ANGLE, count)
        put_articulation(self.cabinet, (*_CABINET, LOW_CABINET.half[2]), _SPREAD, 0.0, count)
        self.mug.set_pose(random_places(_MUG_FROM, _MUG_TO, self.mug_half[env_idx]))
        self.pod.set_pose(self.cabinet.pose * Pose.create_from_pq(self._in_tray(count)))

    def _in_tray(self, count: int) -> torch.Tensor:
        """Where (B, 3) pods stand in shut drawers, in the cabinets' frames."""
        x, y, floor = LOW_CABINET.place
        middle = torch.tensor([x, y, floor + LOW_CABINET.joint.origin[2] + 0.5 * POD_HEIGHT])
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
        seated = (torch.linalg.norm(offset[:, :2], dim=-1) <= SEATED[0]) & (offset[:, 2] <= SEATED[1])
        angle = self.machine.qpos[:, 0]
        holds_mug, holds_pod = self.agent.is_grasping(self.mug), self.agent.is_grasping(self.pod)
        static = self.agent.is_static(_STATIC)
        left = ~holds_mug & ~holds_pod
        return {
            "success": at_machine & seated & (angle <= SHUT_ANGLE) & left & static,
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

        handle = (self.drawer.pose * sapien.Pose(LOW_CABINET.handle)).p
        opened = (info["opening"] / LOW_CABINET.stroke).clamp(0.0, 1.0)
        stands = info["is_mug_at_machine"]
        reward = torch.where(stands, 3.0 + (1.0 - held) * (nearness(tool, handle) + opened), reward)

        held = info["is_grasped"].float()
        put_in = 5.0 + nearness(tool, pod) + held * (1.0 + nearness(pod, self._seat()))
        reward = torch.where(stands & (info["opening"] >= LOW_CABINET.opened), put_in, reward)

        shut = 1.0 - (info["angle"] / OPEN_ANGLE).clamp(0.0, 1.0)
        shutting = 8.0 + (1.0 - held) * (0.5 + 1.5 * shut)
        reward = torch.where(stands & info["is_pod_seated"], shutting, reward)
        return torch.where(info["success"], self.whole, reward)
