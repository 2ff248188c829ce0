"""Registration of every task's environments with Gymnasium, and of tasks that other packages bring."""

from __future__ import annotations

import warnings
from importlib.metadata import EntryPoint, entry_points

import gymnasium as gym

from pwm_gym.tasks import TASKS, Task, register_task
from pwm_gym.tasks.registry import on_registration

__all__ = ["ENTRY_POINTS", "load_plugins", "register_envs"]

ENTRY_POINTS = "pwm_gym.tasks"
"""Group of entry points that name a :class:`Task`, or a function without arguments that registers some."""

_LOADED: set[tuple[str, str]] = set()
"""Name and value of the entry points that were loaded."""


def register_envs() -> None:
    """Register ``pwm/<Task>-v0`` (model) and ``pwm/<Task>Sim-v0`` (simulator) of all tasks, those to come as well.

    Doing so twice is harmless.
    """
    on_registration(_register_task_envs)
    load_plugins()


def load_plugins() -> None:
    """Register the tasks of the entry points of group ``pwm_gym.tasks``; one that fails warns and is left out.

    Example (in a package's ``pyproject.toml``)::

        [project.entry-points."pwm_gym.tasks"]
        my_task = "my_package.my_task:MY_TASK"
    """
    for point in entry_points(group=ENTRY_POINTS):
        key = (point.name, point.value)
        if key in _LOADED:
            continue
        _LOADED.add(key)
        try:
            _load(point)
        except Exception as error:  # a broken plug-in must not break the package
            warnings.warn(f"tasks of entry point {point.name!r} ({point.value}) are left out: {error}", stacklevel=2)


def _load(point: EntryPoint) -> None:
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
