"""Where agents learn: the native batch of the world model, or simulator twins, for stable-baselines3."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecEnvWrapper, VecMonitor

from pwm_gym.agents.config import AgentConfig
from pwm_gym.dynamics import SceneBank
from pwm_gym.envs import SimEnv
from pwm_gym.seeds import RANGES
from pwm_gym.tasks import Task
from pwm_gym.wrappers import EntityPoses, SB3VecEnv
from pwm_gym.wrappers.vector import UncertaintyPenalty

__all__ = ["SuccessIsBest", "make_world"]


class SuccessIsBest(VecEnvWrapper):
    """Rewards less one, so that what ends with success is worth more than what stays short of it.

    Rewards of the shipped tasks lie below 1, which success alone gives, and success ends the episode: unshifted, an
    agent gains by hovering beside its goal. It tells stable-baselines3 of successes, too.
    """

    def reset(self) -> Any:
        """First observations."""
        return self.venv.reset()

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Observations, rewards less one, dones and infos with ``is_success`` at an end."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for i in map(int, np.flatnonzero(dones)):
            infos[i].setdefault("is_success", bool(infos[i].get("success", False)))
        return observations, rewards - 1.0, dones, infos


def make_world(task: Task, config: AgentConfig, scenes: SceneBank | None = None) -> VecEnv:
    """The batch that an agent of a task learns in; its monitor sees the task's own rewards.

    Args:
        task: the task.
        config: of the training.
        scenes: what the model's episodes start from; None takes the checkpoint's.

    Raises:
        PwmGymError, CheckpointError: settings that do not fit the task.
    """
    batch = _model(task, config, scenes) if config.world == "model" else _twins(task, config)
    batch.seed(config.seed)
    return SuccessIsBest(VecMonitor(batch))


def _model(task: Task, config: AgentConfig, scenes: SceneBank | None) -> VecEnv:
    env = gym.make_vec(
        f"pwm/{task.name}-v0",
        num_envs=config.environments,
        checkpoint=config.checkpoint,
        points=config.points or None,
        device=config.device,
        max_episode_steps=config.episode_steps,
        autoreset_mode="SameStep",
        scenes=scenes,
    )
    return SB3VecEnv(UncertaintyPenalty(env, config.caution) if config.caution else env, config.observation)


def _twins(task: Task, config: AgentConfig) -> VecEnv:
    makers = [_Twin(task.name, config) for _ in range(config.environments)]
    return DummyVecEnv(makers) if len(makers) == 1 else SubprocVecEnv(makers, "spawn")


class _Twin:
    """Makes a twin, in whatever process."""

    def __init__(self, task: str, config: AgentConfig) -> None:
        self.task, self.config = task, config

    def __call__(self) -> gym.Env[Any, Any]:
        """The twin."""
        torch.set_num_threads(1)
        twin: gym.Env[Any, Any] = _TrainingSeeds(SimEnv(self.task, points=self.config.points or None))
        seen = EntityPoses(twin) if self.config.observation == "poses" else twin
        return gym.wrappers.TimeLimit(seen, self.config.episode_steps)


class _TrainingSeeds(gym.Wrapper[Any, Any, Any, Any]):
    """Episodes of the simulator's training seeds alone."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Start an episode of a random training seed."""
        if seed is not None:
            self._generator = np.random.default_rng(seed)
        return self.env.reset(seed=int(self._generator.choice(RANGES["train"])), options=options)
