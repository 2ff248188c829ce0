"""What a task is, and the registry of tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from pwm_gym.costs.registry import Function
from pwm_gym.errors import PwmGymError, look_up, unknown_name
from pwm_gym.robots import Control, Robot
from pwm_gym.scene import Layout
from pwm_gym.sim import Simulator

__all__ = ["TASKS", "Expert", "HandPosture", "Task", "get_task", "on_registration", "register_task"]


class Expert(Protocol):
    """A scripted demonstrator that reads a scene and keeps no memory, so that it resumes from any scene."""

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (A,) in [-1, 1].

        Args:
            poses: entity poses (E, 7) in the base's frame.
            goal: (G,), as the task defines it.
            assets: name of each entity's asset (E,), where a task's objects differ between episodes.
        """


@dataclass(frozen=True)
class HandPosture:
    """What a planner need not seek of a hand, because the task tells it.

    Raises:
        PwmGymError: a finger target that is not in [-1, 1].
    """

    heading: Function | None = None
    """Horizontal direction ``(points, info) -> (B, 3)`` that the hand's x axis shall have; None is planned."""
    fingers: tuple[float | None, ...] = ()
    """Targets of its fingers in [-1, 1], None where they are planned; empty where all are."""

    def __post_init__(self) -> None:
        """Check the targets."""
        if off := [target for target in self.fingers if target is not None and not -1.0 <= target <= 1.0]:
            raise PwmGymError(f"finger target {off[0]} of a posture; expected -1 to 1, or None")


@dataclass(frozen=True)
class Task:
    """Everything that one task needs; its file in this folder fills it."""

    name: str
    description: str
    robot: Robot
    layout: Layout
    """The robot's links first, then the task's own entities."""
    simulator: Callable[..., Simulator]
    """Makes a simulator; it takes ``objects`` where the task has :attr:`object_sets`, ``starts`` where it has
    :attr:`starts`."""
    expert: Callable[[np.random.Generator], Expert]
    cost: str
    """Registered cost that ports the simulator's own shaped reward."""
    plan_cost: str
    """Registered cost that planners use by default."""
    success: str
    """Registered success rule."""
    grasp: str = "nothing"
    """Registered grasp rule."""
    planner: str = "mppi"
    """Registered planner that plans it by default."""
    postures: Mapping[str, HandPosture] = field(default_factory=dict)
    """Arm -> posture of its hand, for planners whose hands keep it by themselves."""
    goal_size: int = 0
    """G; 0 where the task has no goal beside its objects."""
    expert_steps: int = 66
    """Mean length of the expert's episodes."""
    object_sets: tuple[str, ...] = ()
    """Names of sets that an episode's objects can be drawn from, the default first; none where they are always the
    same."""
    starts: tuple[str, ...] = ()
    """Names of distributions that episodes can start from, the default first; none where there is one alone."""
    cloud_seed: int = 0
    max_episode_steps: int = 100

    @property
    def control(self) -> Control:
        """What an action's components mean."""
        return self.robot.control

    @property
    def action_size(self) -> int:
        """A."""
        return self.control.size

    def make_simulator(self, objects: str | Sequence[str] | None = None, starts: str | None = None) -> Simulator:
        """A simulator of the task.

        Args:
            objects: what episodes draw their objects from: one of :attr:`object_sets`, an object's name, or names; None
                for the task's default.
            starts: where episodes start: one of :attr:`starts`; None for the default.

        Raises:
            UnknownNameError: there are no such starts.
            PwmGymError: the task's objects are always the same, or some that were asked for are not there.
        """
        options: dict[str, Any] = {}
        if starts is not None:
            if starts not in self.starts:
                raise unknown_name(f"starts of {self.name}", starts, self.starts)
            options["starts"] = starts
        if objects is not None:
            if not self.object_sets:
                raise PwmGymError(f"objects={objects!r}; the objects of {self.name} are always the same")
            options["objects"] = objects
        return self.simulator(**options)

    @property
    def objects(self) -> tuple[str, ...]:
        """Entities that contact moves, in order; the first is the one whose error tables report first."""
        return tuple(e.name for e in self.layout if e.loose or e.articulated)


TASKS: dict[str, Task] = {}
"""Task name -> task."""


_OBSERVERS: list[Callable[[Task], None]] = []


def register_task(task: Task) -> Task:
    """Add ``task`` to the registry, so that every command and Gymnasium know it at once.

    Raises:
        ValueError: the name is taken.
    """
    if task.name in TASKS:
        raise ValueError(f"task {task.name!r} is registered already")
    TASKS[task.name] = task
    for observer in _OBSERVERS:
        observer(task)
    return task


def on_registration(observer: Callable[[Task], None]) -> None:
    """Call ``observer`` with every task: those registered now, and each that will be."""
    if observer in _OBSERVERS:
        return
    _OBSERVERS.append(observer)
    for task in TASKS.values():
        observer(task)


def get_task(name: str) -> Task:
    """The task called ``name``.

    Raises:
        UnknownNameError: listing the known tasks and the nearest one.
    """
    return look_up("task", name, TASKS)
