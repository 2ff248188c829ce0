"""TwoArmDrawerCleanup as a ManiSkill task: one hand opens the drawer, the other fills it, the first shuts it."""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.utils.registration import register_env

from pwm_gym.robots.two_hands import AMID, FACE, HELD, SIDES, SIGN, TOOL, boxes
from pwm_gym.sim.cabinets import DEEP_CABINET
from pwm_gym.sim.maniskill.build import add_shapes
from pwm_gym.sim.maniskill.scenes.common import TwoHandsTableEnv, native_pose
from pwm_gym.sim.maniskill.scenes.parts import build_cabinet, near_places, put_articulation
from pwm_gym.sim.mugs import TALL_MUG
from pwm_gym.sim.nearness import near

__all__ = ["TwoArmDrawerCleanupEnv"]

_CABINET, _CABINET_SPREAD = (0.31, 0.0), (0.015, 0.015, 0.05)  # in the plane; x, y and yaw to either side
_MUG, _MUG_SPREAD = (0.0, -0.27), (0.04, 0.03, 0.4)
_MUG_DENSITY = 500.0
_RED = (0.75, 0.15, 0.12, 1.0)
_SHUT, _IN_TRAY, _EDGE = 0.008, 0.014, 0.025
_STATIC = 0.2  # rad/s


@register_env("TwoArmDrawerCleanup-v1", max_episode_steps=400)
class TwoArmDrawerCleanupEnv(TwoHandsTableEnv):
    """Open a drawer with the left hand, put a mug into it with the right one, shut it with the left one.

    **Randomizations**

    - the cabinet's place by 1.5 cm to either side, and its yaw by 0.05 rad
    - the mug's place by 4 and 3 cm to either side, and its yaw by 0.4 rad

    **Success**: the mug lies in the drawer, not grasped; the drawer is shut to 8 mm; the arms are static.
    """

    whole = 8.0

    def _load_scene(self, options: dict[str, Any]) -> None:
        super()._load_scene(options)
        self.cabinet = build_cabinet(self.scene, _CABINET, DEEP_CABINET)
        self.drawer = self.cabinet.links_map["drawer"]
        builder = self.scene.create_actor_builder()
        add_shapes(builder, TALL_MUG.shapes(), _RED, _MUG_DENSITY)
        builder.initial_pose = sapien.Pose([*_MUG, 0.5 * TALL_MUG.height])
        self.mug = builder.build(name="mug")

    def _place_objects(self, env_idx: torch.Tensor) -> None:
        put_articulation(self.cabinet, (*_CABINET, DEEP_CABINET.half[2]), _CABINET_SPREAD, 0.0, len(env_idx))
        self.mug.set_pose(near_places((*_MUG, 0.5 * TALL_MUG.height), _MUG_SPREAD, len(env_idx)))

    def _holds(self, side: str, mug: sapien.Pose) -> bool:
        """Whether fingers and thumb of one hand touch the mug between them."""
        palm = native_pose(self.agent.robot.links_map[f"{side}_palm"])
        x, y, z = (palm.inv() * mug).p - np.array(TOOL)
        thumb = palm.inv() * native_pose(self.agent.robot.links_map[f"{side}_thumb_2"])
        size, _ = boxes(f"{side}_thumb_2")[0]
        inner = [(thumb * sapien.Pose([0.0, -0.5 * SIGN[side] * size[1], h * size[2]])).p[0] for h in (0.3, 0.6, 1.0)]
        gaps = x - TALL_MUG.radius - FACE, min(inner) - TOOL[0] - x - TALL_MUG.radius
        touching = all(low <= gap <= high for gap, (low, high) in zip(gaps, HELD, strict=True))
        return bool(touching and abs(y) <= AMID[0] and abs(z) <= AMID[1])

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Whether the mug is in the drawer, how far this is open, and success."""
        drawer, mug = native_pose(self.drawer), native_pose(self.mug)
        offset = (drawer.inv() * mug).p
        low, high = np.array(DEEP_CABINET.tray)
        within = bool(((offset[:2] >= low + _EDGE) & (offset[:2] <= high - _EDGE)).all())
        inside = within and offset[2] - 0.5 * TALL_MUG.height - DEEP_CABINET.tray_floor <= _IN_TRAY
        opening = float(self.cabinet._objs[0].qpos[0])
        grasped = any(self._holds(side, mug) for side in SIDES)
        static = bool(self.agent.is_static(_STATIC)[0])
        found = {
            "success": inside and opening <= _SHUT and not grasped and static,
            "is_grasped": grasped,
            "is_mug_inside": bool(inside),
            "is_robot_static": static,
            "opening": opening,
        }
        return {name: torch.tensor([value]) for name, value in found.items()}

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, torch.Tensor]:
        found = {f"{side}_tool": torch.as_tensor(self.tool(side).p)[None] for side in SIDES}
        if "state" in self.obs_mode:
            found["cabinet_pose"] = self.cabinet.pose.raw_pose
            found["opening"] = info["opening"]
            found["mug_pose"] = self.mug.pose.raw_pose
        return found | {"is_grasped": info["is_grasped"]}

    def compute_dense_reward(self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]) -> torch.Tensor:
        """Shaped reward (1,) from 0 to 8: open (to 2), put the mug in (to 5), shut (to 7), success."""
        if info["success"]:
            return torch.tensor([self.whole])
        drawer, mug = native_pose(self.drawer), native_pose(self.mug)
        held, opening = float(info["is_grasped"]), float(info["opening"])
        reach_handle = near(self.tool("left").p, (drawer * sapien.Pose(DEEP_CABINET.handle)).p)
        opened = min(max(opening / DEEP_CABINET.stroke, 0.0), 1.0)
        if info["is_mug_inside"]:
            reward = 5.0 + (1.0 - held) * (1.5 + 0.5 * reach_handle - opened)
        elif opening >= DEEP_CABINET.opened:
            place = (drawer * sapien.Pose(DEEP_CABINET.place)).p + [0.0, 0.0, 0.5 * TALL_MUG.height]
            reward = 2.0 + near(self.tool("right").p, mug.p) + held * (1.0 + near(mug.p, place))
        else:
            reward = reach_handle + opened
        return torch.tensor([reward], dtype=torch.float32)
