"""Where the time of a collection on MuJoCo Warp goes, beside that of a collection without it.

python benchmarks/warp_collection.py --task FetchPush --json benchmarks/results/warp_collection.json
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tyro

from pwm_gym.collection import CollectConfig
from pwm_gym.collection.recording import record_episode
from pwm_gym.collection.shards import Shard
from pwm_gym.collection.warp import collect_in_worlds
from pwm_gym.evaluation import write_results
from pwm_gym.sim.mujoco.warp import WarpWorlds, import_warp
from pwm_gym.tasks import Task, get_task


@dataclass
class Args:
    """What to measure."""

    task: str = "FetchPush"
    """Registered task of MuJoCo."""
    worlds: int = 2
    """Worlds at once."""
    episodes: int = 4
    """Half of them are demonstrations, half practice."""
    json: Path | None = None
    """Where the figures go, too."""


@dataclass
class Clock:
    """Time spent in a part of the work."""

    seconds: float = 0.0
    cpu_seconds: float = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        """Add what passes meanwhile."""
        start, cpu_start = time.perf_counter(), time.process_time()
        yield
        self.seconds += time.perf_counter() - start
        self.cpu_seconds += time.process_time() - cpu_start


@dataclass
class Stepping:
    """Counts and times the control steps of worlds."""

    clock: Clock = field(default_factory=Clock)
    control_steps: int = 0

    def watch(self, worlds: WarpWorlds) -> None:
        """Take the time of each :meth:`WarpWorlds.advance` from now on."""
        advance = worlds.advance

        def timed() -> None:
            with self.clock.running():
                advance()
            self.control_steps += 1

        worlds.advance = timed  # type: ignore[method-assign]


def measure(args: Args) -> dict[str, Any]:
    """The figures: milliseconds for each step of an episode, by part."""
    task = get_task(args.task)
    _, warp = import_warp()
    with TemporaryDirectory() as folder:
        config = CollectConfig(args.task, out=Path(folder), episodes=args.episodes)
        shards = [
            Shard(Path(folder) / f"{kind}.npz", range(args.episodes // 2), kind, config)
            for kind in ("demonstration", "practice")
        ]
        worlds = WarpWorlds(task.make_simulator(), args.worlds)
        worlds.reset(range(args.worlds))
        worlds.advance()  # compiles the kernels
        stepping, whole, steps = Stepping(), Clock(), Clock()
        stepping.watch(worlds)
        with whole.running():
            list(collect_in_worlds(worlds, task, shards))
        with steps.running():
            plain = sum(_record(task, shard) for shard in shards)
    device = stepping.clock
    frame_skip = worlds.simulator.world.frame_skip
    return {
        "task": args.task,
        "device": str(warp.get_device()),
        "worlds": args.worlds,
        "episode_steps": plain,
        "host_cpu_ms_a_step": 1e3 * (whole.cpu_seconds - device.cpu_seconds) / plain,
        "warp_ms_a_control_step_of_all_worlds": 1e3 * device.seconds / stepping.control_steps,
        "physics_steps_a_second": args.worlds * frame_skip * stepping.control_steps / device.seconds,
        "without_warp_cpu_ms_a_step": 1e3 * steps.cpu_seconds / plain,
    }


def _record(task: Task, shard: Shard) -> int:
    """Steps of a shard's episodes, recorded without Warp."""
    simulator = task.make_simulator()
    make, limit = shard.behaviours(task), shard.limit(task)
    return sum(len(record_episode(simulator, seed, make, limit)) for seed in shard.seeds)


def main(args: Args) -> None:
    """Print the figures, and write them."""
    figures = measure(args)
    for name, value in figures.items():
        print(f"{name:40} {value:.3f}" if isinstance(value, float) else f"{name:40} {value}")
    if args.json is not None:
        write_results(args.json, figures)


if __name__ == "__main__":
    main(tyro.cli(Args))
