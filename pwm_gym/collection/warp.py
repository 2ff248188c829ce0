"""Collection in many worlds at once, which MuJoCo Warp steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from pwm_gym.collection.recording import Recording
from pwm_gym.collection.shards import Shard, save_assets
from pwm_gym.data.episodes import Episode
from pwm_gym.sim.mujoco.warp import WarpWorlds
from pwm_gym.tasks import Task

__all__ = ["collect_in_worlds"]


@dataclass
class _Part:
    """A shard, and what of it was collected."""

    shard: Shard
    episodes: dict[int, Episode] = field(default_factory=dict)
    """Seed -> episode."""

    @property
    def whole(self) -> bool:
        """Whether all its episodes are over."""
        return len(self.episodes) == len(self.shard.seeds)


@dataclass
class _Running:
    """An episode that is being recorded."""

    part: _Part
    seed: int
    recording: Recording


def collect_in_worlds(worlds: WarpWorlds, task: Task, shards: Sequence[Shard]) -> Iterator[int]:
    """Collect shards and write them; the number of episodes of each, as they are whole.

    A world whose episode is over goes on with the next one of any shard, so that none waits.

    Args:
        worlds: of the task's simulator.
        task: the task.
        shards: to collect, none of them of on-policy episodes: these share one planner.

    Raises:
        PwmGymError: a world diverged, or has more contacts than there is room for.
    """
    waiting = ((part, seed) for part in map(_Part, shards) for seed in part.shard.seeds)
    running = {}
    for world, (part, seed) in zip(range(len(worlds)), waiting, strict=False):
        running[world] = _begin(worlds, world, task, part, seed)
    while running:
        worlds.advance()
        for world, episode in [*running.items()]:
            simulator = worlds.view(world)
            episode.recording.add(simulator, simulator.outcome())
            if not episode.recording.done:
                worlds.drive(world, episode.recording.act(simulator))
                continue
            part = episode.part
            part.episodes[episode.seed] = episode.recording.episode()
            if part.whole:
                part.shard.write(task, [part.episodes[seed] for seed in part.shard.seeds])
                part.episodes.clear()
                yield len(part.shard.seeds)
            if (following := next(waiting, None)) is None:
                worlds.end(world)
                del running[world]
            else:
                running[world] = _begin(worlds, world, task, *following)


def _begin(worlds: WarpWorlds, world: int, task: Task, part: _Part, seed: int) -> _Running:
    """Start an episode, up to its first action."""
    simulator = worlds.begin(world, seed)
    behaviour = part.shard.behaviours(task)(seed)
    recording = Recording(simulator, seed, behaviour, part.shard.limit(task))
    worlds.keep(world)  # a behaviour may have changed where the episode starts
    save_assets(part.shard.config.folder, task, simulator)
    worlds.drive(world, recording.act(simulator))
    return _Running(part, seed, recording)
