"""PickCube: lift the cube from the table to a goal position in the air (ManiSkill ``PickCube-v1``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from pwm_gym.costs import Points, register_grasp, register_success, register_terms, terms
from pwm_gym.robots import panda
from pwm_gym.scene import Layout, Support
from pwm_gym.sim import Simulator
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["PICK_CUBE", "PickCubeExpert"]

_CUBE_WIDTH = 0.04  # metres
_GOAL_RADIUS = 0.025  # metres: ManiSkill's threshold for the cube's distance from the goal
_RATE = 20.0  # control steps a second
_STATIC = 0.2  # rad/s: ManiSkill's threshold for the arm's fastest joint
_ARM_JOINTS = 7  # of the robot; the others are its fingers
_AVERAGED = 0.87  # joint speed at a step's end over its average in the step, where the arm comes to rest
_JOINT_SPEEDS = torch.tensor([[2.05, -1.57], [3.38, 0.585], [-0.444, -2.16]])
"""Speeds (rad/s) of the Panda's second, fourth and sixth joint per radial and vertical speed (m/s) of its hand in the
task's postures: least squares on recorded demonstrations."""

Info = Mapping[str, Any]


@register_grasp("pick_cube")
def _grasped(points: Points, info: Info) -> Tensor:
    return terms.near_and_shut(points, info["action"], "cube")


@register_success("pick_cube")
def _success(points: Points, info: Info) -> Tensor:
    """Cube within 2.5 cm of the goal and the arm static."""
    return (_goal_distance(points, info) <= _GOAL_RADIUS) & (_joint_speed(points, info) <= _STATIC)


def _joint_speed(points: Points, info: Info) -> Tensor:
    """Speed (B,) in rad/s of the arm's fastest joint; where joints are not known, as the hand's motion tells it.

    The second, fourth and sixth joint move the hand in its upright plane, the first one moves it sideways, and the last
    one makes the turn that the first one does not.
    """
    joints = info.get("joints")
    if joints is not None:
        return _RATE * joints[..., 1, :_ARM_JOINTS].abs().amax(-1)
    position = terms.centre(points, "hand")
    velocity = _RATE * terms.centre(info["velocity"], "hand")
    radius = position[..., :2].norm(dim=-1).clamp_min(1e-3)
    outward = position[..., :2] / radius.unsqueeze(-1)
    radial = (velocity[..., :2] * outward).sum(-1)
    sideways = velocity[..., 1] * outward[..., 0] - velocity[..., 0] * outward[..., 1]
    bending = torch.stack([radial, velocity[..., 2]], -1) @ _JOINT_SPEEDS.to(velocity).T
    base = sideways / radius
    wrist = _RATE * terms.spin(points, info["velocity"], "hand") - base
    return _AVERAGED * torch.stack([bending.abs().amax(-1), base.abs(), wrist.abs()]).amax(0)


def _goal_distance(points: Points, info: Info) -> Tensor:
    return (terms.centre(points, "cube") - info["goal"]).norm(dim=-1)


def _reach_distance(points: Points) -> Tensor:
    return (terms.centre(points, "cube") - terms.tool_centre(points)).norm(dim=-1)


# ManiSkill's shaped reward, on clouds -----------------------------------------------------------------------------


def _reaching(points: Points, info: Info) -> Tensor:
    return 1.0 - torch.tanh(5.0 * _reach_distance(points))


def _contact(points: Points, info: Info) -> Tensor:
    return terms.pinched(points, info["action"], "cube").float()


def _placing(points: Points, info: Info) -> Tensor:
    return _contact(points, info) * (1.0 - torch.tanh(5.0 * _goal_distance(points, info)))


def _static(points: Points, info: Info) -> Tensor:
    rest = 1.0 - torch.tanh(5.0 * _joint_speed(points, info))
    return rest * (_goal_distance(points, info) <= _GOAL_RADIUS)


def _bonus(points: Points, info: Info) -> Tensor:
    """What success adds, so that the reward is exactly 1 there."""
    parts = _reaching(points, info) + _contact(points, info) + _placing(points, info) + _static(points, info)
    return (5.0 - parts) * _success(points, info)


register_terms(
    "pick_cube",  # minus ManiSkill's normalised shaped reward; -1 at success
    {
        "reaching": (-0.2, _reaching),
        "contact": (-0.2, _contact),
        "placing": (-0.2, _placing),
        "static": (-0.2, _static),
        "success": (-0.2, _bonus),
    },
)


# The planners' cost: a grasp that cannot be fooled ----------------------------------------------------------------

_SUNK = 0.010  # metres by which a pad may overlap the cube's extent and still count as pressing on it
_CLEAR = 0.05  # metres over the cube's centre at which open fingers clear its top


def _approach(points: Points, info: Info) -> Tensor:
    """Distance from tool to cube, sharper when near."""
    distance = _reach_distance(points)
    return 5.0 * distance + torch.tanh(distance / 0.02)


def _early(points: Points, info: Info) -> Tensor:
    """Shut before the cube is between the fingers."""
    gaps = terms.finger_gaps(points, "cube")
    width = (terms.centre(points, "left_gripper") - terms.centre(points, "right_gripper")).norm(dim=-1)
    shut = ((0.100 - width) / 0.04).clamp(0, 1)  # the fingers' centres are 10.7 cm apart when open, 2.7 cm shut
    crushed = torch.sigmoid(-(gaps.amin(-1) + _SUNK) / 0.002)
    return shut * torch.maximum(_away(points), crushed)


def _low(points: Points, info: Info) -> Tensor:
    """Fingers at the cube's height that overlap it along their own axis: coming closer, they would push it."""
    height = terms.tool_centre(points)[..., 2] - terms.centre(points, "cube")[..., 2]
    depth = ((_CLEAR - height) / _CLEAR).clamp(0, 1)
    blocked = torch.sigmoid((0.002 - terms.finger_gaps(points, "cube").amin(-1)) / 0.002)
    return blocked * depth * _away(points)


def _away(points: Points) -> Tensor:
    """Soft bool: the cube is not between the finger tips."""
    return torch.sigmoid((_reach_distance(points) - 0.013) / 0.002)


def _press(points: Points, info: Info) -> Tensor:
    """Finger tips nearer than 5 mm to the table, which would stop the arm; 1 where they touch it."""
    lowest = torch.minimum(points["left_gripper"][..., 2].amin(-1), points["right_gripper"][..., 2].amin(-1))
    return ((0.005 - lowest) / 0.005).clamp(0, 2)


def _effort(points: Points, info: Info) -> Tensor:
    """Translations over half a unit: near the edge of the arm's reach the controller finds no pose, and stops."""
    return 4.0 * (info["action"][..., :3].norm(dim=-1) - 0.5).clamp_min(0.0).square()


def _disturb(points: Points, info: Info) -> Tensor:
    """Speed of a cube that is not held, in units of 5 mm a step: it is being pushed, or it falls."""
    pushed = (terms.speed(info["velocity"], "cube") / 0.005).clamp_max(4.0)
    return pushed * (1 - _firm(points, info))


def _firm(points: Points, info: Info) -> Tensor:
    """Soft form of :func:`pwm_gym.costs.terms.pinched`, in [0, 1]; a model lets the pads sink deeper."""
    gaps = terms.finger_gaps(points, "cube")
    pressing = torch.sigmoid((0.001 - gaps.amax(-1)) / 0.0007) * torch.sigmoid((gaps.amin(-1) + _SUNK) / 0.001)
    near = torch.sigmoid((0.020 - _reach_distance(points)) / 0.002)
    return pressing * near * (info["action"][..., -1] < 0)


def _askew(points: Points, info: Info) -> Tensor:
    """How much wider than a side the cube is along the fingers' axis: 0 where they are aligned, 1 on its diagonal."""
    width = terms.width_between(points, "cube")
    return ((width - _CUBE_WIDTH) / (0.414 * _CUBE_WIDTH)).clamp(0, 1)


def _carry(points: Points, info: Info) -> Tensor:
    """Distance from cube to goal counts once the grasp is firm."""
    distance = _goal_distance(points, info)
    return _firm(points, info) * (4.0 - 8.0 * distance.clamp_max(0.4) - torch.tanh(distance / 0.03))


def _settle(points: Points, info: Info) -> Tensor:
    """Speed of the arm (in units of the static limit) near the goal."""
    near = torch.sigmoid((0.015 - _goal_distance(points, info)) / 0.003)
    return near * (_joint_speed(points, info) / _STATIC).clamp_max(3.0)


register_terms(
    "pick_cube_plan",  # reach from above with open fingers, pinch, carry, settle
    {
        "approach": (1.5, _approach),
        "early": (4.0, _early),
        "low": (3.0, _low),
        "askew": (2.0, _askew),
        "press": (1.0, _press),
        "effort": (1.0, _effort),
        "disturb": (0.5, _disturb),
        "carry": (-2.0, _carry),
        "settle": (0.3, _settle),
    },
)


# The scripted expert ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PickCubeExpert:
    """Hover, descend, grasp, carry: each phase is told from the poses alone."""

    speed: float
    """Longest translation asked of the controller in one step, metres; it lags and makes about half of it."""
    hover: float = 0.08
    """Height of the tool over the cube before it descends, metres."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> PickCubeExpert:
        """Expert of a random speed and hover height."""
        return cls(speed=rng.uniform(0.0105, 0.018), hover=rng.uniform(0.06, 0.10))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (7,) for poses (4, 7) of hand, fingers and cube, and the cube's goal (3,)."""
        tool, cube = panda.tool_pose(poses), poses[3]
        reach = cube[:3] - tool[:3]
        turn = _yaw_error(tool, cube)
        if self._holds(poses, reach):
            return self._move(goal - cube[:3], 0.0, gripper=-1.0)
        if np.linalg.norm(reach[:2]) < 0.006 and abs(reach[2]) < 0.008 and abs(turn) < 0.12:
            return self._move(reach, turn, gripper=-1.0)
        if np.linalg.norm(reach[:2]) < 0.012 and abs(turn) < 0.12:
            return self._move(reach, turn, gripper=1.0)
        above = reach + [0.0, 0.0, self.hover]
        if above[2] > 0.02 and np.linalg.norm(reach[:2]) > 0.02:  # rise before moving sideways
            above[:2] = 0.0
        return self._move(above, turn, gripper=1.0)

    def _holds(self, poses: np.ndarray, reach: np.ndarray) -> bool:
        stopped = abs(panda.opening(poses) - _CUBE_WIDTH) < 0.006
        return bool(stopped and np.linalg.norm(reach) < 0.018)

    def _move(self, offset: np.ndarray, turn: float, gripper: float) -> np.ndarray:
        distance = float(np.linalg.norm(offset))
        step = offset * min(1.0, self.speed / max(distance, 1e-9))
        return panda.delta_pose_action(step, np.array([0.0, 0.0, np.clip(turn, -0.1, 0.1)]), gripper)


def _yaw_error(tool: np.ndarray, cube: np.ndarray) -> float:
    """Smallest turn about z, radians, that aligns the fingers with two sides of the cube."""
    x_tool = Rotation.from_quat(tool[3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    sides = Rotation.from_quat(cube[3:], scalar_first=True).as_matrix()
    side = sides[:, np.argmin(np.abs(sides[2]))]  # an axis of the cube that lies flat
    error = np.arctan2(side[1], side[0]) - np.arctan2(x_tool[1], x_tool[0])
    return float((error + np.pi / 4) % (np.pi / 2) - np.pi / 4)


def _simulator() -> Simulator:
    from pwm_gym.sim.maniskill import ManiSkillSimulator

    return ManiSkillSimulator("PickCube-v1", {**panda.PANDA.links, "cube": "cube"}, goal="goal_site")


PICK_CUBE = register_task(
    Task(
        name="PickCube",
        description="Lift the cube from the table to a goal position in the air.",
        layout=Layout.build(
            [("hand", 300), ("left_gripper", 300), ("right_gripper", 300), ("cube", 300)],
            driven=panda.PANDA.driven,
            joints=panda.PANDA.joints,
            supports=[Support.ground()],
        ),
        goal_size=3,
        robot=panda.PANDA,
        simulator=_simulator,
        expert=PickCubeExpert.sample,
        cost="pick_cube",
        plan_cost="pick_cube_plan",
        success="pick_cube",
        grasp="pick_cube",
    )
)
