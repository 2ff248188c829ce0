"""TwoArmBoxCleanup as a ManiSkill task: two hands take a box's lid and put it on the box."""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.utils.registration import register_env

from pwm_gym.robots.two_hands import FACE, SIDES, SIGN
from pwm_gym.sim.lidded_box import BESIDE, BOX, BOX_HALF, GRIP_HEIGHT, LID, LID_HALF, ON_BOX, PRESSED
from pwm_gym.sim.maniskill.build import add_shapes
from pwm_gym.sim.maniskill.scenes.common import TwoHandsTableEnv, native_pose
from pwm_gym.sim.maniskill.scenes.parts import near_places
from pwm_gym.sim.nearness import near

__all__ = ["TwoArmBoxCleanupEnv"]

_LID, _BOX = (-0.03, 0.0), (0.24, 0.0)  # where they stand, in the plane
_LID_SPREAD, _BOX_SPREAD = (0.03, 0.03, 0.15), (0.015, 0.03, 0.10)  # x, y and yaw, to either side
_LID_DENSITY, _BOX_DENSITY = 180.0, 700.0
_GREY, _BLUE = (0.45, 0.47, 0.5, 1.0), (0.2, 0.35, 0.7, 1.0)
RELEASED = 0.020
"""Gap between a hand and the lid's side, metres, from which it has left the lid."""
SEATED = (0.013, 0.005, 0.06)
"""Beside and over the lid's place on the box, metres, and its tilt, radians: it is on the box."""
_STATIC = 0.2  # rad/s


@register_env("TwoArmBoxCleanup-v1", max_episode_steps=330)
class TwoArmBoxCleanupEnv(TwoHandsTableEnv):
    """Take the lid between two hands and put it on the box.

    **Randomizations**

    - the lid's place by 3 cm to either side, and its yaw by 0.15 rad
    - the box's place by 1.5 and 3 cm to either side, and its yaw by 0.1 rad

    **Success**: the lid is on the box, both hands have left it by 2 cm, and the arms are static.
    """

    whole = 5.0

    def _load_scene(self, options: dict[str, Any]) -> None:
        super()._load_scene(options)
        self.box = self._build("box", BOX, _BLUE, _BOX_DENSITY, (*_BOX, BOX_HALF[2]))
        self.lid = self._build("lid", LID, _GREY, _LID_DENSITY, (*_LID, LID_HALF[2]))

    def _build(self, name: str, shapes: Any, color: Any, density: float, place: tuple[float, float, float]) -> Any:
        builder = self.scene.create_actor_builder()
        rubbing = sapien.physx.PhysxMaterial(1.0, 1.0, 0.0)
        add_shapes(builder, shapes, color, density, rubbing)
        builder.initial_pose = sapien.Pose(place)
        return builder.build(name=name)

    def _place_objects(self, env_idx: torch.Tensor) -> None:
        self.lid.set_pose(near_places((*_LID, LID_HALF[2]), _LID_SPREAD, len(env_idx)))
        self.box.set_pose(near_places((*_BOX, BOX_HALF[2]), _BOX_SPREAD, len(env_idx)))

    def _gap(self, side: str, lid: sapien.Pose) -> float:
        """Gap between one hand and the side of the lid; 1 m where it is not beside it."""
        x, y, z = (lid.inv() * self.tool(side)).p
        if abs(x) > LID_HALF[0] or abs(z) > BESIDE:
            return 1.0
        return float(SIGN[side] * y - LID_HALF[1] - FACE)

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Whether the lid is held, whether it is on the box, and success."""
        lid, box = native_pose(self.lid), native_pose(self.box)
        gaps = [self._gap(side, lid) for side in SIDES]
        held = all(PRESSED[0] <= gap <= PRESSED[1] for gap in gaps)
        offset = lid.p - box.p
        upright = lid.to_transformation_matrix()[2, 2] >= np.cos(SEATED[2])
        seated = np.hypot(*offset[:2]) <= SEATED[0] and abs(offset[2] - ON_BOX) <= SEATED[1] and upright
        static = bool(self.agent.is_static(_STATIC)[0])
        found = {
            "success": seated and min(gaps) >= RELEASED and static,
            "is_grasped": held,
            "is_lid_on_box": bool(seated),
            "is_robot_static": static,
            "gap": min(gaps),
        }
        return {name: torch.tensor([value]) for name, value in found.items()}

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, torch.Tensor]:
        found = {f"{side}_tool": torch.as_tensor(self.tool(side).p)[None] for side in SIDES}
        if "state" in self.obs_mode:
            found["lid_pose"] = self.lid.pose.raw_pose
            found["box_pose"] = self.box.pose.raw_pose
        return found | {"is_grasped": info["is_grasped"]}

    def compute_dense_reward(self, obs: Any, action: torch.Tensor, info: dict[str, torch.Tensor]) -> torch.Tensor:
        """Shaped reward (1,) from 0 to 5: reach the lid's sides (1), hold it (1), bring it (1), leave it, success."""
        if info["success"]:
            return torch.tensor([self.whole])
        if info["is_lid_on_box"]:
            return 3.0 + (info["gap"] / RELEASED).clamp(0.0, 1.0)
        lid = native_pose(self.lid)
        grips = {side: lid * sapien.Pose([0.0, SIGN[side] * (LID_HALF[1] + FACE), GRIP_HEIGHT]) for side in SIDES}
        reward = 0.5 * sum(near(self.tool(side).p, grips[side].p) for side in SIDES)
        if info["is_grasped"]:
            reward += 1.0 + near(lid.p, native_pose(self.box).p + [0.0, 0.0, ON_BOX])
        return torch.tensor([reward], dtype=torch.float32)
