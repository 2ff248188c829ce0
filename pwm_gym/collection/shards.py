"""Shards that a collection consists of: whose episodes they hold, and who acts in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pwm_gym.collection.behaviours import Behaviour, Demonstration, Mirrored, OnPolicy, Practice
from pwm_gym.collection.config import CollectConfig
from pwm_gym.collection.practice import PRACTICE_STEPS
from pwm_gym.data.dataset import asset_path, save_asset
from pwm_gym.data.episodes import FORMAT, Episode, read_shard, write_shard
from pwm_gym.dynamics.checkpoint import load_checkpoint, resolve
from pwm_gym.errors import DatasetError
from pwm_gym.planning import Agent
from pwm_gym.scene import SCHEMA, sample_clouds
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

__all__ = ["SHARD_KINDS", "Shard", "save_assets"]

SHARD_KINDS = ("demonstration", "practice", "on_policy")
"""Who acts in the episodes of a shard."""

_PATIENCE = 1.8  # of an expert's usual length, after which a demonstration that has not succeeded ends
_ON_POLICY_STEPS = 60
_MIRROR = 1  # of the generator that draws which scenes are mirrored


@dataclass(frozen=True)
class Shard:
    """Episodes that one file holds."""

    path: Path
    seeds: range
    kind: str
    """One of :data:`SHARD_KINDS`."""
    config: CollectConfig
    agent: Callable[[Task], Agent] | None = None
    """Makes who acts in on-policy episodes; None: the planner with the model of the configuration's checkpoint."""

    def is_whole(self, task: Task) -> bool:
        """Whether the file holds all its episodes."""
        try:
            return len(read_shard(self.path, task.name)) == len(self.seeds)
        except DatasetError:
            return False

    def limit(self, task: Task) -> int:
        """Steps of an episode at most."""
        longest = round(_PATIENCE * task.expert_steps)
        return {"demonstration": longest, "practice": PRACTICE_STEPS, "on_policy": _ON_POLICY_STEPS}[self.kind]

    def behaviours(self, task: Task) -> Callable[[int], Behaviour]:
        """Who acts in the episode of a seed, in the task's own scene or in the mirrored one."""
        config, kind = self.config, SHARD_KINDS.index(self.kind)
        act = self._on_policy(task) if self.kind == "on_policy" else partial(self._unplanned, task)

        def make(seed: int) -> Behaviour:
            behaviour = act(seed)
            aside = np.random.default_rng([seed, kind, _MIRROR]).random() < config.mirrored
            return Mirrored(task, behaviour) if aside else behaviour

        return make

    def _on_policy(self, task: Task) -> Callable[[int], Behaviour]:
        """A planner or a policy, for all episodes of the shard."""
        if self.agent is None:
            agent = Agent(load_checkpoint(resolve(self.config.checkpoint, task.name)).model, task.name)
        else:
            agent = self.agent(task)
        return partial(OnPolicy, task, agent, jitter=self.config.jitter)

    def _unplanned(self, task: Task, seed: int) -> Behaviour:
        """Practice or a demonstration."""
        config, rng = self.config, np.random.default_rng([seed, SHARD_KINDS.index(self.kind)])
        if self.kind == "practice":
            return Practice(task, rng)
        return Demonstration(task, rng, randomise=config.randomise, jitter=config.jitter)

    def write(self, task: Task, episodes: Sequence[Episode]) -> None:
        """Write the file."""
        write_shard(self.path, episodes, {"format": FORMAT, "schema": SCHEMA, "task": task.name})


def save_assets(folder: Path, task: Task, simulator: Simulator) -> None:
    """Sample the canonical clouds of the present episode's assets that the data set does not have yet."""
    names = simulator.assets()
    if all(asset_path(folder, name).exists() for name in names):
        return
    clouds = sample_clouds(simulator.meshes(), task.layout, task.cloud_seed)
    for name, entity in zip(names, task.layout, strict=True):
        save_asset(folder, name, clouds[entity.slice])
