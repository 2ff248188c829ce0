"""Collection of episodes in parallel processes: resumable, crash-safe, the same data for any number of workers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

from pwm_gym.collection.config import CollectConfig
from pwm_gym.collection.recording import record_episode
from pwm_gym.collection.shards import SHARD_KINDS, Shard, save_assets
from pwm_gym.collection.warp import collect_in_worlds
from pwm_gym.data.dataset import FORMAT, read_header
from pwm_gym.data.episodes import KINDS
from pwm_gym.data.simulated import check_objects
from pwm_gym.errors import DatasetError
from pwm_gym.files import write_atomically
from pwm_gym.planning import Agent
from pwm_gym.scene import SCHEMA
from pwm_gym.seeds import RANGES
from pwm_gym.sim import Simulator
from pwm_gym.sim.mujoco.warp import WarpWorlds, import_warp
from pwm_gym.tasks import Task, get_task
from pwm_gym.workers import Workers, work_through

__all__ = ["collect"]


def collect(
    config: CollectConfig,
    progress: bool = True,
    workers: int | Workers | None = None,
    agent: Callable[[Task], Agent] | None = None,
) -> Path:
    """Collect a data set into ``config.folder`` and return that.

    Shards that exist and are whole are kept, so a killed run resumes; truncated ones are collected again.

    Args:
        config: what to collect.
        progress: whether to show a bar.
        workers: who collects; None takes ``config.workers`` processes of this machine. With ``config.warp`` this
            process does.
        agent: makes the one that ``config.policy`` names, in whatever process; it must survive pickle.

    Raises:
        DatasetError: there is a policy and no agent, or the other way round; the folder holds a data set of another
            task or configuration, or lost files meanwhile.
        PwmGymError: the task has no such objects, one of several processes died, or MuJoCo Warp was asked for and is
            not installed or cannot step the task.
    """
    task = get_task(config.task)
    if bool(config.policy) != (agent is not None):
        raise DatasetError(f"policy={config.policy!r} and agent={agent}; expected both or neither")
    every = list(_shards(config, agent))
    worlds = _worlds(config, task, every) if config.warp else None
    _write_header(config, task)
    missing = [shard for shard in every if not shard.is_whole(task)]
    if worlds is None:
        counts = work_through(_collect_shard, missing, workers or config.workers, _one_thread)
    else:
        counts = collect_in_worlds(worlds, task, missing)
    total = sum(len(shard.seeds) for shard in missing)
    with tqdm(total=total, unit="episode", disable=not progress, desc=f"collect {task.name}") as bar:
        for count in counts:
            bar.update(count)
    _check_complete(config.folder, every)
    return config.folder


def _worlds(config: CollectConfig, task: Task, shards: list[Shard]) -> WarpWorlds:
    """Worlds of the task's simulator, no more than there are episodes."""
    import_warp()  # before a simulator is made, which takes seconds
    simulator = task.make_simulator(config.objects or None)
    return WarpWorlds(simulator, min(config.warp, sum(len(shard.seeds) for shard in shards)))


def _check_complete(folder: Path, shards: list[Shard]) -> None:
    """Raise :class:`DatasetError` where files are gone that were there or were written."""
    paths = [folder / "dataset.json", *(shard.path for shard in shards)]
    if missing := [path.name for path in paths if not path.exists()]:
        raise DatasetError(
            f"{folder} lost {len(missing)} of {len(paths)} files while it was collected ({missing[0]}, ...); "
            "collect again to replace them"
        )


def _write_header(config: CollectConfig, task: Task) -> None:
    settings = {k: v for k, v in asdict(config).items() if k not in ("out", "workers", "episodes", "held_out")}
    settings["warp"] = config.warp > 0  # however many worlds
    for name in ("objects", "policy", "jitter", "mirrored", "warp"):  # data sets of an earlier version do not tell them
        if not settings[name]:
            del settings[name]
    header = {
        "format": FORMAT,
        "schema": SCHEMA,
        "settings": settings,
        "layout": task.layout.to_json(),
        "kinds": list(KINDS),
    }
    path = config.folder / "dataset.json"
    if path.exists():
        found = read_header(config.folder).settings
        if found != settings:
            raise DatasetError(f"{config.folder} was collected with {found}; expected {settings}")
        return
    check_objects(task, config.objects)
    write_atomically(path, json.dumps(header).encode())


def _shards(config: CollectConfig, agent: Callable[[Task], Agent] | None) -> Iterator[Shard]:
    """Shards of all splits; each kind takes seeds of its own third of a split."""
    held_out = max(config.held_out, config.episodes // 10)
    counts = {"train": config.episodes, "validation": held_out, "test": held_out}
    for split, count in counts.items():
        planned = round(count * config.on_policy) if split == "train" else 0
        practice = round(count * config.practice)
        third = len(RANGES[split]) // len(SHARD_KINDS)
        for place, (kind, number) in enumerate(
            zip(SHARD_KINDS, (count - practice - planned, practice, planned), strict=True)
        ):
            seeds = RANGES[split][place * third + config.offset :][:number]
            for k in range(0, number, config.shard):
                path = config.folder / f"{split}-{kind}-{k // config.shard:05d}.npz"
                yield Shard(path, seeds[k : k + config.shard], kind, config, agent)


def _one_thread() -> None:
    import torch

    torch.set_num_threads(1)


_SIMULATORS: dict[tuple[str, str], Simulator] = {}  # one a process, task and set of objects: making one takes seconds


def _collect_shard(shard: Shard) -> int:
    task = get_task(shard.config.task)
    key = (task.name, shard.config.objects)
    if key not in _SIMULATORS:
        _SIMULATORS[key] = task.make_simulator(shard.config.objects or None)
    simulator = _SIMULATORS[key]

    behaviour, limit = shard.behaviours(task), shard.limit(task)
    episodes = []
    for seed in shard.seeds:
        episodes.append(record_episode(simulator, seed, behaviour, limit))
        save_assets(shard.config.folder, task, simulator)
    shard.write(task, episodes)
    return len(episodes)
