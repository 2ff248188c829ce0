"""Steps the model's batch, alone and in wrappers, for long, and tells how its memory grows.

python benchmarks/soak.py --steps 100000 --json benchmarks/results/soak.json
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from tqdm import tqdm

import pwm_gym  # noqa: F401  (registers)
from pwm_gym.evaluation import write_results
from pwm_gym.process import prepare_process
from pwm_gym.wrappers import EntityPoses, SB3VecEnv

__all__ = ["SUBJECTS", "Growth", "soak"]

_WARM = 0.2  # share of the steps before memory is looked at: caches fill, and the allocator finds its size
_LOOKS = 200  # at memory
_EPISODE = 50  # steps, so that resets are a part of it
_PAGE = os.sysconf("SC_PAGE_SIZE")

Step = Callable[[], Any]


@dataclass(frozen=True)
class Growth:
    """Memory over a soak."""

    steps: int
    seconds: float
    start_mib: float
    """Resident when the caches were full."""
    end_mib: float
    slope_mib: float
    """Growth over 100,000 steps, by least squares."""
    objects: int
    """Python's objects at the end more than at the start."""


def resident_mib() -> float:
    """Resident memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE / 2**20


def _batch(count: int, mode: str = "NextStep", **settings: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
    return gym.make_vec(
        "pwm/PickCube-v0", num_envs=count, max_episode_steps=_EPISODE, autoreset_mode=mode, points=120, **settings
    )


def _steps_of(env: gym.vector.VectorEnv[Any, Any, Any]) -> Step:
    env.reset(seed=0)
    env.action_space.seed(0)
    return lambda: env.step(env.action_space.sample())


def _plain(count: int) -> Step:
    return _steps_of(_batch(count))


def _poses(count: int) -> Step:
    return _steps_of(_batch(count, observation="poses"))


def _recorded(count: int) -> Step:
    """Gymnasium's statistics of episodes around the batch."""
    return _steps_of(gym.wrappers.vector.RecordEpisodeStatistics(_batch(count)))


def _stable_baselines(count: int) -> Step:
    env = SB3VecEnv(_batch(count, "SameStep"))
    env.seed(0)
    env.reset()
    rng = np.random.default_rng(0)
    return lambda: env.step(rng.uniform(-1, 1, (count, 7)))


def _single(count: int) -> Step:
    """A single environment, with its wrappers, that starts anew at each end."""
    env = EntityPoses(gym.make("pwm/PickCube-v0", points=120, max_episode_steps=_EPISODE))
    env.reset(seed=0)
    env.action_space.seed(0)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()

    return step


SUBJECTS: Mapping[str, Callable[[int], Step]] = {
    "batch": _plain,
    "batch of poses": _poses,
    "batch with statistics": _recorded,
    "stable-baselines3": _stable_baselines,
    "single, wrapped": _single,
}
"""What is stepped, given the number of environments."""


def soak(step: Step, steps: int, progress: bool = True) -> Growth:
    """Step for long, and fit a line through the memory.

    Args:
        step: one step.
        steps: how many are looked at, after a fifth as many that are not.
        progress: whether to show a bar.
    """
    for _ in range(int(_WARM * steps)):
        step()
    gc.collect()
    before, begun = len(gc.get_objects()), time.perf_counter()
    every, at, memory = max(1, steps // _LOOKS), [], []
    for k in tqdm(range(steps), disable=not progress, unit="step", mininterval=5.0):
        if k % every == 0:
            at.append(k)
            memory.append(resident_mib())
        step()
    seconds = time.perf_counter() - begun
    gc.collect()
    slope = float(np.polyfit(at, memory, 1)[0]) * 100_000
    return Growth(steps, seconds, memory[0], memory[-1], slope, len(gc.get_objects()) - before)


@dataclass(frozen=True)
class Soak:
    """Step environments for long, and tell how memory grows."""

    steps: int = 100_000
    """Vector steps in all, shared evenly."""
    num_envs: int = 8
    """Environments of a batch."""
    subjects: tuple[str, ...] = tuple(SUBJECTS)
    """What is stepped."""
    json: Path | None = None
    """Where to write the results."""

    def run(self) -> None:
        """Print and write how memory grew."""
        prepare_process(1)
        rows = {}
        for name in self.subjects:
            found = soak(SUBJECTS[name](self.num_envs), self.steps // len(self.subjects))
            rows[name] = asdict(found)
            print(
                f"  {name:24} {found.steps} steps in {found.seconds:.0f} s, {found.start_mib:.0f} MiB to "
                f"{found.end_mib:.0f} MiB: {found.slope_mib:+.1f} MiB in 100,000 steps, {found.objects:+d} objects",
                flush=True,
            )
        if self.json is not None:
            write_results(self.json, {"steps": self.steps, "num_envs": self.num_envs, "subjects": rows})


if __name__ == "__main__":
    tyro.cli(Soak).run()
