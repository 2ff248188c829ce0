"""Collection of episodes in parallel processes: resumable, crash-safe, the same data for any number of workers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pwm_gym.collection.behaviours import Behaviour, Demonstration, OnPolicy, Practice
from pwm_gym.collection.practice import PRACTICE_STEPS
from pwm_gym.data.dataset import FORMAT, asset_path, read_header, save_asset
from pwm_gym.data.episodes import FORMAT as EPISODES
from pwm_gym.data.episodes import KINDS, Episode, read_shard, write_shard
from pwm_gym.data.simulated import check_objects
from pwm_gym.dynamics.checkpoint import load_checkpoint, resolve
from pwm_gym.errors import DatasetError
from pwm_gym.files import write_atomically
from pwm_gym.planning import Agent
from pwm_gym.scene import SCHEMA, sample_clouds
from pwm_gym.seeds import RANGES
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task, get_task
from pwm_gym.workers import Workers, work_through

__all__ = ["CollectConfig", "collect", "record_episode"]

_PATIENCE = 1.8  # of an expert's usual length, after which a demonstration that has not succeeded ends
_PLANNED_STEPS = 60
_KINDS = ("demonstration", "practice", "on_policy")


@dataclass(frozen=True)
class CollectConfig:
    """What to collect.

    Raises:
        DatasetError: a number that cannot be.
    """

    task: str = "PickCube"
    """Registered task."""
    objects: str = ""
    """What episodes draw their objects from, where they differ: one of the task's sets, such as "liftable", or an
    object's name; the task's default if not given."""
    out: Path | None = None
    """Folder of the data set; None takes ``data-sets/`` and the task's name. A run that was killed goes on where it
    was."""
    episodes: int = 1000
    """Training episodes; validation and test get a tenth as many each, at least ``held_out``."""
    held_out: int = 20
    """Episodes of validation, and of test, at least."""
    practice: float = 0.5
    """Share of practice episodes; what is left of both shares are demonstrations."""
    on_policy: float = 0.0
    """Share of training episodes that a planner runs in the simulator with ``checkpoint``; it succeeds sooner than the
    expert, so that they are short, but planning each takes half a minute."""
    checkpoint: str = "default"
    """Whose model plans the on-policy episodes: a folder or a shipped checkpoint's name."""
    offset: int = 0
    """First seed of each split, so that several data sets of a task share none."""
    randomise: float = 0.2
    """Share of demonstrations that switch to random actions at a random step (the paper's 20 %)."""
    jitter: float = 0.0
    """Largest standard deviation of the noise that is added to what an expert asks of arms, in action units, so that
    data hold small mistakes and how they are put right."""
    workers: int = 2
    """Processes."""
    shard: int = 20
    """Episodes a file."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        for name, least in {"episodes": 1, "held_out": 1, "workers": 1, "shard": 1, "offset": 0}.items():
            if getattr(self, name) < least:
                raise DatasetError(f"{name}={getattr(self, name)}; expected at least {least}")
        for name in ("practice", "on_policy", "randomise", "jitter"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise DatasetError(f"{name}={getattr(self, name)}; expected a share from 0 to 1")
        if self.practice + self.on_policy > 1.0:
            raise DatasetError(f"practice={self.practice} and on_policy={self.on_policy}; expected at most 1 together")

    @property
    def folder(self) -> Path:
        """Folder of the data set."""
        return Path("data-sets") / self.task if self.out is None else self.out


@dataclass(frozen=True)
class _Job:
    path: Path
    seeds: range
    kind: str
    """"demonstration", "practice" or "on_policy"."""
    config: CollectConfig


def collect(config: CollectConfig, progress: bool = True, workers: int | Workers | None = None) -> Path:
    """Collect a data set into ``config.folder`` and return that.

    Shards that exist and are whole are kept, so a killed run resumes; truncated ones are collected again.

    Args:
        config: what to collect.
        progress: whether to show a bar.
        workers: who collects; None takes ``config.workers`` processes of this machine.

    Raises:
        DatasetError: the folder holds a data set of another task or configuration, or lost files meanwhile.
        PwmGymError: the task has no such objects, or one of several processes died.
    """
    task = get_task(config.task)
    _write_header(config, task)
    every = list(_jobs(config))
    jobs = [job for job in every if not _is_whole(job, task)]
    total = sum(len(job.seeds) for job in jobs)
    with tqdm(total=total, unit="episode", disable=not progress, desc=f"collect {task.name}") as bar:
        for count in work_through(_collect_shard, jobs, workers or config.workers, _one_thread):
            bar.update(count)
    _check_complete(config.folder, every)
    return config.folder


def _check_complete(folder: Path, jobs: list[_Job]) -> None:
    """Raise :class:`DatasetError` where files are gone that were there or were written."""
    paths = [folder / "dataset.json", *(job.path for job in jobs)]
    if missing := [path.name for path in paths if not path.exists()]:
        raise DatasetError(
            f"{folder} lost {len(missing)} of {len(paths)} files while it was collected ({missing[0]}, ...); "
            "collect again to replace them"
        )


def _write_header(config: CollectConfig, task: Task) -> None:
    settings = {k: v for k, v in asdict(config).items() if k not in ("out", "workers", "episodes", "held_out")}
    for name in ("objects", "jitter"):  # data sets of an earlier version do not tell them
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


def _jobs(config: CollectConfig) -> Iterator[_Job]:
    """Shards of all splits; each kind takes seeds of its own third of a split."""
    held_out = max(config.held_out, config.episodes // 10)
    counts = {"train": config.episodes, "validation": held_out, "test": held_out}
    for split, count in counts.items():
        planned = round(count * config.on_policy) if split == "train" else 0
        practice = round(count * config.practice)
        third = len(RANGES[split]) // len(_KINDS)
        for place, (kind, number) in enumerate(
            zip(_KINDS, (count - practice - planned, practice, planned), strict=True)
        ):
            seeds = RANGES[split][place * third + config.offset :][:number]
            for k in range(0, number, config.shard):
                path = config.folder / f"{split}-{kind}-{k // config.shard:05d}.npz"
                yield _Job(path, seeds[k : k + config.shard], kind, config)


def _is_whole(job: _Job, task: Task) -> bool:
    try:
        return len(read_shard(job.path, task.name)) == len(job.seeds)
    except DatasetError:
        return False


def _one_thread() -> None:
    import torch

    torch.set_num_threads(1)


_SIMULATORS: dict[tuple[str, str], Simulator] = {}  # one a process, task and set of objects: making one takes seconds


def _collect_shard(job: _Job) -> int:
    task = get_task(job.config.task)
    key = (task.name, job.config.objects)
    if key not in _SIMULATORS:
        _SIMULATORS[key] = task.make_simulator(job.config.objects or None)
    simulator = _SIMULATORS[key]

    longest = round(_PATIENCE * task.expert_steps)
    limits = {"demonstration": longest, "practice": PRACTICE_STEPS, "on_policy": _PLANNED_STEPS}
    behaviour = _behaviours(job, task)
    episodes = []
    for seed in job.seeds:
        episodes.append(record_episode(simulator, seed, behaviour, limits[job.kind]))
        _save_assets(job.config.folder, task, simulator)
    write_shard(job.path, episodes, {"format": EPISODES, "schema": SCHEMA, "task": task.name})
    return len(episodes)


def _save_assets(folder: Path, task: Task, simulator: Simulator) -> None:
    """Sample the canonical clouds of the present episode's assets that the data set does not have yet."""
    names = simulator.assets()
    if all(asset_path(folder, name).exists() for name in names):
        return
    clouds = sample_clouds(simulator.meshes(), task.layout, task.cloud_seed)
    for name, entity in zip(names, task.layout, strict=True):
        save_asset(folder, name, clouds[entity.slice])


def _behaviours(job: _Job, task: Task) -> Callable[[int], Behaviour]:
    """Who acts in the episode of a seed."""

    def rng(seed: int) -> np.random.Generator:
        return np.random.default_rng([seed, _KINDS.index(job.kind)])

    if job.kind == "practice":
        return lambda seed: Practice(task, rng(seed))
    if job.kind == "demonstration":
        return lambda seed: Demonstration(task, rng(seed), randomise=job.config.randomise, jitter=job.config.jitter)
    checkpoint = load_checkpoint(resolve(job.config.checkpoint, task.name))
    agent = Agent(checkpoint.model, task.name)
    return lambda seed: OnPolicy(task, agent, seed)


def record_episode(simulator: Simulator, seed: int, make: Callable[[int], Behaviour], limit: int) -> Episode:
    """One episode of at most ``limit`` steps from ``seed``; at least three, so that it has both velocities."""
    simulator.reset(seed)
    behaviour = make(seed)
    behaviour.start(simulator)
    goal, assets = simulator.goal(), simulator.assets()  # a goal may move later
    poses, joints, actions, outcomes = [simulator.poses()], [simulator.joints()], [], []
    for step in range(limit):
        action = behaviour.act(simulator)
        outcome = simulator.step(action)
        actions.append(action)
        outcomes.append(outcome)
        poses.append(simulator.poses())
        joints.append(simulator.joints())
        if behaviour.done(outcome.success) and step >= 2:
            break
    return Episode(
        poses=np.asarray(poses, np.float32),
        joints=np.asarray(joints, np.float32),
        actions=np.asarray(actions, np.float32),
        rewards=np.array([o.reward for o in outcomes], np.float32),
        success=np.array([o.success for o in outcomes]),
        grasped=np.array([o.grasped for o in outcomes]),
        goal=goal,
        kind=KINDS.index(behaviour.kind),
        seed=seed,
        switch=behaviour.switch,
        assets=assets,
    )
