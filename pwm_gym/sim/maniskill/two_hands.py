"""Two Pandas with hands as a ManiSkill agent, and their controller in NumPy.

ManiSkill's own controllers take most of a step for two arms: their tensors hold 34 numbers. This one reads and writes
SAPIEN's arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from gymnasium import spaces
from mani_skill.agents.base_agent import BaseAgent, Keyframe
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig
from mani_skill.agents.registration import register_agent
from mani_skill.utils import sapien_utils

from pwm_gym.errors import PwmGymError
from pwm_gym.robots.control import Arm
from pwm_gym.robots.solver import ArmSolver
from pwm_gym.robots.two_hands import DRIVEN, JOINT_NAMES, REST, SIDES, TWO_HANDS
from pwm_gym.robots.two_hands_urdf import urdf_file
from pwm_gym.sim.maniskill.adapter import ManiSkillSimulator

__all__ = ["TwoHandsAgent", "TwoHandsController", "TwoHandsControllerConfig", "two_hands_simulator"]

_ARM_DRIVE = (1000.0, 100.0, 100.0)  # stiffness, damping, largest torque: as ManiSkill drives a Panda
_FINGER_DRIVE = (150.0, 10.0, 15.0)
_UNREACHED = 2e-3  # metres by which a solution may miss; where it misses by more, the arm holds instead of jumping
_FRICTION, _PATCH = 2.0, 0.1  # of all links of the hands
_GROUPS = {"left": 1 << 27, "right": 1 << 28}  # links of one arm and its hand pass through each other


class TwoHandsController(BaseController):
    """Drives joints to where each tool's changed pose, and the targets of its fingers, are.

    An arm whose tool would be more than 2 mm off holds its joints for that step; :attr:`holding` names it.
    """

    config: TwoHandsControllerConfig

    def _initialize_joints(self) -> None:
        if self.articulation.scene.num_envs > 1 or self.articulation.scene.gpu_sim_enabled:
            raise PwmGymError("two_hands is driven in one environment on the CPU; got several, or a GPU's")
        known = [joint.name for joint in self.articulation.get_active_joints()]
        if lacking := [name for name in JOINT_NAMES if name not in known]:
            raise PwmGymError(
                f"the robot has no joint {lacking[0]!r}; two hands are driven by all of {len(JOINT_NAMES)}"
            )
        super()._initialize_joints()
        self._native = self.articulation._objs[0]
        self.order = [known.index(name) for name in JOINT_NAMES]
        self._drives = [self._native.active_joints[k] for k in self.order]
        self._arms = {arm.name: ArmSolver(arm.chain) for arm in TWO_HANDS.control.arms if arm.chain is not None}
        self.holding: tuple[str, ...] = ()

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(-1.0, 1.0, (TWO_HANDS.control.size,), np.float32)

    def set_drive_property(self) -> None:
        """Drives of arms and fingers."""
        for name, joint in zip(JOINT_NAMES, self._drives, strict=True):
            stiffness, damping, force = _ARM_DRIVE if "panda" in name else _FINGER_DRIVE
            joint.set_drive_properties(stiffness, damping, force, "force")
            joint.set_friction(0.0)

    def reset(self) -> None:
        """Nothing is held."""
        self.holding = ()

    def set_action(self, action: torch.Tensor) -> None:
        """Set the joints' targets for an action (1, 24)."""
        values = np.asarray(self._preprocess_action(action)[0], np.float64)
        joints = self._native.qpos[self.order]
        targets, holding = joints.copy(), []
        for arm in TWO_HANDS.control.arms:
            solution, reached = self._solution(arm, joints[arm.joints], values)
            if reached:
                targets[arm.joints] = solution
            else:
                holding.append(arm.name)
            targets[_hand_joints(arm)] = _finger_positions(arm.name, values)
        self.holding = tuple(holding)
        for joint, target in zip(self._drives, targets, strict=True):
            joint.set_drive_target(target)

    def _solution(self, arm: Arm, joints: np.ndarray, action: np.ndarray) -> tuple[np.ndarray, bool]:
        """Angles (J,) that the arm is asked to take, and whether they bring its tool there."""
        solver = self._arms[arm.name]
        move, turn = (TWO_HANDS.control.channel(arm.name, kind) for kind in ("translation", "rotation"))
        assert move is not None and turn is not None
        angles = action[turn.slice] / max(float(np.linalg.norm(action[turn.slice])), 1.0)
        goal = solver.target(solver.tool(joints), move.unit * action[move.slice], turn.unit * angles)
        solution, miss = solver.solve(goal, joints)
        return solution, miss <= _UNREACHED  # not a number is no solution either


def _hand_joints(arm: Arm) -> slice:
    """The hand's joints in the robot's joint vector, behind its arm's."""
    count = len(JOINT_NAMES) // len(SIDES)
    return slice(arm.joints.stop, arm.first_joint + count)


def _finger_positions(side: str, action: np.ndarray) -> np.ndarray:
    """Positions (10,) of a hand's joints for the targets of those that are driven; the others follow."""
    fingers = TWO_HANDS.control.channel(side, "finger")
    assert fingers is not None
    shares = dict(zip(DRIVEN[side], 0.5 * (action[fingers.slice] + 1.0), strict=True))
    positions = {
        name: joint.lower + shares[name] * (joint.upper - joint.lower)
        for name, joint in TWO_HANDS.joints.items()
        if name in shares
    }
    followers = {
        name: joint.mimic.multiplier * positions[joint.mimic.entity] + joint.mimic.offset
        for name, joint in TWO_HANDS.joints.items()
        if joint.mimic is not None and joint.mimic.entity in positions
    }
    positions |= followers
    return np.array([positions[name] for name in TWO_HANDS.joints if name in positions])


@dataclass
class TwoHandsControllerConfig(ControllerConfig):
    """Configuration of :class:`TwoHandsController`; it has no settings but the joints' names."""

    controller_cls = TwoHandsController


@register_agent()
class TwoHandsAgent(BaseAgent):
    """Two Pandas with five-fingered hands; the root link lies amid their bases."""

    uid = TWO_HANDS.name
    keyframes: ClassVar[dict[str, Keyframe]] = {"rest": Keyframe(pose=sapien.Pose(), qpos=np.array(REST))}

    @property
    def _controller_configs(self) -> dict[str, Any]:
        return {"pd_ee_delta_pose": TwoHandsControllerConfig(list(JOINT_NAMES))}

    def _load_articulation(self, initial_pose: Any = None) -> None:
        loader = self.scene.create_urdf_loader()
        loader.name, loader.fix_root_link = self.uid, True
        links = {
            name: {"material": "hand", "patch_radius": _PATCH, "min_patch_radius": _PATCH} for name in TWO_HANDS.links
        }
        hand = {"static_friction": _FRICTION, "dynamic_friction": _FRICTION, "restitution": 0.0}
        sapien_utils.apply_urdf_config(
            loader, sapien_utils.parse_urdf_config({"_materials": {"hand": hand}, "link": links})
        )
        with urdf_file() as path:
            builder = loader.parse(str(path))["articulation_builders"][0]
        for link in builder.link_builders:
            for side, group in _GROUPS.items():
                if link.name.startswith(side):
                    link.collision_groups[2] |= group
        builder.initial_pose = initial_pose
        self.robot = builder.build()
        self.robot_link_names = [link.name for link in self.robot.get_links()]

    def rest(self, noise: np.ndarray) -> np.ndarray:
        """Usual joint positions (34,) in SAPIEN's order, an arm's with ``noise`` (34,) added, radians."""
        positions = np.array(REST)
        for arm in TWO_HANDS.control.arms:
            positions[arm.joints] += noise[arm.joints]
        found = np.empty_like(positions)
        found[self.controller.order] = positions
        return found

    def is_static(self, threshold: float = 0.2) -> torch.Tensor:
        """Bool (1,): whether no joint of an arm is faster than ``threshold`` rad/s."""
        speeds = np.abs(self.robot._objs[0].qvel[self.controller.order])
        fastest = max(float(speeds[arm.joints].max()) for arm in TWO_HANDS.control.arms)
        return torch.tensor([fastest <= threshold])


def two_hands_simulator(task: str, bodies: Mapping[str, str]) -> ManiSkillSimulator:
    """A ManiSkill task of two arms.

    Args:
        task: its id.
        bodies: entity -> actor or articulation's link, of all that is not the robot's.
    """
    return ManiSkillSimulator(
        task,
        {**TWO_HANDS.links, **bodies},
        control=TWO_HANDS.control,
        robot_uids=TWO_HANDS.name,
        joint_names=JOINT_NAMES,
    )
