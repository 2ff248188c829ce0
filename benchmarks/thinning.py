"""Thins a task's clouds by farthest-point sampling, and tells what that changes and saves.

Every entity's points come in the order of farthest-point sampling, so that a thinner cloud is each one's first points.

python benchmarks/thinning.py --task TwoArmDrawerCleanup --json benchmarks/results/thinning_two_arm_drawer_cleanup.json
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from tqdm import tqdm

import pwm_gym  # noqa: F401  (registers)
from pwm_gym.evaluation import write_results
from pwm_gym.process import prepare_process
from pwm_gym.tasks import get_task

__all__ = ["Thinning", "measure"]


def measure(task: str, points: int, envs: int, steps: int) -> dict[str, Any]:
    """Rewards (steps, envs), last places (envs, E, 3) and seconds a step of a batch of so many points a scene."""
    env = gym.make_vec(f"pwm/{task}-v0", num_envs=envs, points=points)
    env.reset(seed=0)
    rng, rewards = np.random.default_rng(0), []
    actions = rng.uniform(-0.5, 0.5, (steps, envs, get_task(task).action_size)).astype(np.float32)
    begun = time.perf_counter()
    for action in actions:
        rewards.append(env.step(action)[1])
    seconds = (time.perf_counter() - begun) / steps
    places = env.unwrapped.state.poses()[..., :3, 3].numpy()  # type: ignore[attr-defined]
    env.close()
    return {"rewards": np.stack(rewards), "places": places, "seconds": seconds}


@dataclass(frozen=True)
class Thinning:
    """Thins a task's clouds by farthest-point sampling, and tells what that changes and saves."""

    task: str = "TwoArmDrawerCleanup"
    shares: tuple[float, ...] = (0.5, 0.25, 0.1, 0.05)
    """Of the task's points."""
    envs: int = 32
    steps: int = 30
    threads: int = 1
    json: Path | None = None

    def run(self) -> None:
        """Print the table and write the results."""
        prepare_process(self.threads)
        whole = get_task(self.task).layout.points
        counts = [whole, *(round(share * whole) for share in self.shares)]
        full, rows = None, {}
        for count in tqdm(counts, desc="thinning", unit="cloud"):
            found = measure(self.task, count, self.envs, self.steps)
            full = full or found
            off = np.abs(found["rewards"] - full["rewards"])
            moved = np.linalg.norm(found["places"] - full["places"], axis=-1)
            rows[str(count)] = {
                "steps_per_second": self.envs / found["seconds"],
                "reward_difference_mean": float(off.mean()),
                "reward_difference_most": float(off.max()),
                "entity_difference_mm": 1000 * float(moved.mean()),
            }
            print(count, {key: round(value, 4) for key, value in rows[str(count)].items()})
        if self.json is not None:
            settings = {"task": self.task, "envs": self.envs, "steps": self.steps}
            write_results(self.json, {**settings, "rows": rows})


if __name__ == "__main__":
    tyro.cli(Thinning).run()
