"""What a task is, and the registry of tasks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pwm_gym.errors import look_up
from pwm_gym.robots import Control, RobotCloud
from pwm_gym.scene import Layout
from pwm_gym.sim import Simulator

__all__ = ["TASKS", "Arm", "Expert", "Task", "get_task", "register_task"]


class Expert(Protocol):
    """A scripted demonstrator that reads poses and keeps no memory, so that it resumes from any scene."""

    def act(self, poses: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Action (A,) in [-1, 1] for entity poses (E, 7) and goal (G,) in the base's frame."""


@dataclass(frozen=True)
class Arm:
    """One end effector as the tasks' scripts drive it."""

    tool: Callable[[np.ndarray], np.ndarray]
    """Entity poses (E, 7) -> tool centre pose (7,)."""
    action: Callable[[np.ndarray, np.ndarray, float], np.ndarray]
    """Translation (3,) in metres, rotation vector (3,) in radians, gripper in [-1, 1] -> action (A,)."""


@dataclass(frozen=True)
class Task:
    """Everything that one task needs; its file in this folder fills it."""

    name: str
    description: str
    layout: Layout
    action_size: int
    goal_size: int
    action_names: tuple[str, ...]
    control: Control
    arm: Arm
    object: str
    """Entity that is to be moved."""
    simulator: Callable[[], Simulator]
    robot: Callable[[], RobotCloud]
    """The robot's links from its joint angles, in the order of the simulator's joints."""
    expert: Callable[[np.random.Generator], Expert]
    cost: str
    """Registered cost that ports the simulator's own shaped reward."""
    plan_cost: str
    """Registered cost that planners use by default."""
    success: str
    """Registered success rule."""
    grasp: str
    """Registered grasp rule."""
    cloud_seed: int = 0
    max_episode_steps: int = 100


TASKS: dict[str, Task] = {}
"""Task name -> task."""


def register_task(task: Task) -> Task:
    """Add ``task`` to the registry; a name can be taken once."""
    if task.name in TASKS:
        raise ValueError(f"task {task.name!r} is registered already")
    TASKS[task.name] = task
    return task


def get_task(name: str) -> Task:
    """The task called ``name``.

    Raises:
        UnknownNameError: listing the known tasks and the nearest one.
    """
    return look_up("task", name, TASKS)
