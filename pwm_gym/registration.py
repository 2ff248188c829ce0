"""Registration of every task's environments with Gymnasium."""

from __future__ import annotations

import gymnasium as gym

from pwm_gym.tasks import TASKS

__all__ = ["register_envs"]


def register_envs() -> None:
    """Register ``pwm/<Task>-v0`` (model) and ``pwm/<Task>Sim-v0`` (simulator); doing so twice is harmless."""
    for task in TASKS.values():
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
