"""The Fetch tasks of Gymnasium-Robotics as simulators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pwm_gym.robots.fetch import FETCH, TABLE_HEIGHT, opening
from pwm_gym.sim.mujoco.adapter import MujocoSimulator
from pwm_gym.sim.mujoco.worlds import RoboticsWorld
from pwm_gym.sim.nearness import near
from pwm_gym.sim.protocol import SimOutcome

__all__ = ["GOAL_RADIUS", "OBJECT", "Instant", "fetch_simulator"]

GOAL_RADIUS = 0.05
"""Metres from the goal within which the tasks are solved."""
OBJECT = "object"
"""Entity that the tasks are about."""

_HAND = (-0.154, -0.063, -0.04), (-0.032, 0.063, 0.04)
"""Corners, in its own frame, of a box around the hand, which stands for its mesh: that is under a licence (CC BY-NC-SA)
by which no points of it may be shipped with a checkpoint's scenes."""
_SHUT = 0.01  # metres between the pads of a gripper that holds nothing


@dataclass(frozen=True)
class Instant:
    """What rewards read of the simulator's state; places (3,) are in the base's frame, metres."""

    tool: np.ndarray
    object: np.ndarray
    """The object's centre; the tool, where there is no object."""
    goal: np.ndarray
    held: bool
    """Whether both fingers touch the object, and are not shut."""

    @property
    def reach(self) -> float:
        """Nearness of the tool to the object: 1 - tanh(5 d) at ``d`` metres."""
        return near(self.tool, self.object)

    @property
    def place(self) -> float:
        """Nearness of the object to the goal: 1 - tanh(5 d) at ``d`` metres."""
        return near(self.object, self.goal)

    @property
    def pushed(self) -> float:
        """Reward of the pushing tasks, in [0, 1]: a quarter of :attr:`reach`, three of :attr:`place`."""
        return 0.25 * (self.reach + 3.0 * self.place)

    @property
    def success(self) -> bool:
        """The environments' own rule."""
        return bool(np.linalg.norm(self.object - self.goal) < GOAL_RADIUS)


def fetch_simulator(env_id: str, reward: Callable[[Instant], float], objects: Sequence[str] = ()) -> MujocoSimulator:
    """A Fetch task; the public frame is the robot's base, lifted to the table's top.

    Args:
        env_id: Gymnasium id, such as ``"FetchPush-v4"``.
        reward: dense reward in [0, 1] of an instant without success; success is worth 1.
        objects: :data:`OBJECT`, where there is one.
    """
    import trimesh

    world = RoboticsWorld(env_id)
    world.reset(0)
    bodies = {**FETCH.links, **dict.fromkeys(objects, "object0")}

    def judge(simulator: MujocoSimulator) -> SimOutcome:
        now = _instant(simulator, bool(objects))
        return SimOutcome(1.0 if now.success else reward(now), now.success, now.held)

    surfaces = {"hand": trimesh.creation.box(bounds=_HAND)}
    return MujocoSimulator(world, bodies, judge, base=_base(world), control=FETCH.control, surfaces=surfaces)


def _base(world: Any) -> np.ndarray:
    """The base's pose (7,) in the simulator's world, lifted to the table's top."""
    place = world.data.body("robot0:base_link").xpos
    return np.array([place[0], place[1], TABLE_HEIGHT, 1.0, 0.0, 0.0, 0.0])


def _instant(simulator: MujocoSimulator, has_object: bool) -> Instant:
    assert FETCH.tool is not None
    poses = simulator.poses()
    tool = FETCH.tool(poses)[:3]
    apart = has_object and opening(poses) > _SHUT
    held = apart and all(simulator.touching(finger, OBJECT) for finger in ("left_gripper", "right_gripper"))
    return Instant(tool, poses[-1, :3] if has_object else tool, simulator.goal().astype(float), held)
