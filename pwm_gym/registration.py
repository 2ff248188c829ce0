"""Registration of every task's environments with Gymnasium, and of tasks that other packages bring."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType

import gymnasium as gym

from pwm_gym.costs import COSTS, register_cost
from pwm_gym.errors import PwmGymError
from pwm_gym.tasks import TASKS, Task, register_task
from pwm_gym.tasks.registry import on_registration

__all__ = ["COST_ENTRY_POINTS", "ENTRY_POINTS", "load_plugins", "register_envs"]

ENTRY_POINTS = "pwm_gym.tasks"
"""Group of entry points that name a :class:`Task`, or a function without arguments that registers some."""
COST_ENTRY_POINTS = "pwm_gym.costs"
"""Group of entry points that name a cost function, registered under the entry point's name, or a module that registers
some."""

_LOADED: set[tuple[str, str]] = set()
"""Name and value of the entry points that were loaded."""


def register_envs() -> None:
    """Register ``pwm/<Task>-v0`` (model) and ``pwm/<Task>Sim-v0`` (simulator) of all tasks, those to come as well.

    Doing so twice is harmless.
    """
    on_registration(_register_task_envs)
    load_plugins()


def load_plugins() -> None:
    """Register the costs and tasks of other packages' entry points; one that fails warns and is left out.

    Example (in a package's ``pyproject.toml``)::

        [project.entry-points."pwm_gym.tasks"]
        my_task = "my_package.my_task:MY_TASK"

        [project.entry-points."pwm_gym.costs"]
        my_cost = "my_package.costs:my_cost"
    """
    _load_group(COST_ENTRY_POINTS, "costs", _load_cost)  # tasks may name them
    _load_group(ENTRY_POINTS, "tasks", _load_task)


def _load_group(group: str, kind: str, load: Callable[[EntryPoint], None]) -> None:
    for point in entry_points(group=group):
        key = (point.name, point.value)
        if key in _LOADED:
            continue
        _LOADED.add(key)
        try:
            load(point)
        except Exception as error:  # a broken plug-in must not break the package
            warnings.warn(f"{kind} of entry point {point.name!r} ({point.value}) are left out: {error}", stacklevel=3)


def _load_cost(point: EntryPoint) -> None:
    found = point.load()
    if isinstance(found, ModuleType):  # it has registered what it brings
        return
    if not callable(found):
        raise PwmGymError(f"it names {found!r}; expected a cost function or a module")
    if point.name not in COSTS or COSTS[point.name].terms.get(point.name, (0, None))[1] is not found:
        register_cost(point.name)(found)


def _load_task(point: EntryPoint) -> None:
    found = point.load()
    if not isinstance(found, Task):
        found()
    elif TASKS.get(found.name) is not found:  # its module may have registered it already
        register_task(found)


def _register_task_envs(task: Task) -> None:
    _register(f"pwm/{task.name}-v0", "ModelEnv", task.name, task.max_episode_steps, native_batch=True)
    _register(f"pwm/{task.name}Sim-v0", "SimEnv", task.name, task.max_episode_steps, native_batch=False)


def _register(name: str, env: str, task: str, steps: int, native_batch: bool) -> None:
    if name in gym.registry:
        return
    gym.register(
        id=name,
        entry_point=f"pwm_gym.envs:{env}",
        vector_entry_point="pwm_gym.envs:ModelVectorEnv" if native_batch else None,
        max_episode_steps=steps,
        nondeterministic=False,
        kwargs={"task": task},
    )
