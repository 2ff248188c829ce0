"""What is left to do from OGBench's starts in play, and what becomes of it where the robot is asked for nothing.

python benchmarks/play_starts.py --episodes 100 --json benchmarks/results/play_starts.json
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from pwm_gym.evaluation import write_results
from pwm_gym.seeds import seed_range
from pwm_gym.sim import Simulator
from pwm_gym.tasks import get_task

__all__ = ["Start", "look", "summary"]

_IDLE = np.array([0.0, 0.0, 0.0, 0.0, 0.0], np.float32)  # the tool stays, and so does the gripper's opening


@dataclass(frozen=True)
class Start:
    """One episode's start."""

    way: float
    """Metres from the cube to its goal, the farthest one's where there are several."""
    held: bool
    solved: bool
    """Whether it is a success at once."""
    idle: bool
    """Whether it becomes one where nothing is asked for."""


def look(simulator: Simulator, cubes: tuple[int, ...], seed: int, steps: int) -> Start:
    """The start of ``seed``, and up to ``steps`` steps without an action.

    Args:
        simulator: of a Cube task that starts in play.
        cubes: their places among the entities.
        seed: of the episode.
        steps: of the episode at most.
    """
    simulator.reset(seed)
    outcome, goals = simulator.outcome(), simulator.goal().reshape(-1, 3)
    way = np.linalg.norm(simulator.poses()[list(cubes), :3] - goals, axis=1).max()
    idle = any(simulator.step(_IDLE).success for _ in range(steps))
    return Start(float(way), outcome.grasped, outcome.success, idle)


def summary(starts: list[Start]) -> dict[str, Any]:
    """Shares and ways of the starts."""
    ways = np.array([start.way for start in starts])
    return {
        "episodes": len(starts),
        "solved": float(np.mean([start.solved for start in starts])),
        "solved_idle": float(np.mean([start.idle for start in starts])),
        "held": float(np.mean([start.held for start in starts])),
        "way_m": {str(q): float(np.quantile(ways, q / 100)) for q in (25, 50, 75, 90)},
    }


def main(
    task: str = "OGBenchCubeSingle",
    episodes: int = 100,
    steps: int = 50,
    json: Path | None = None,
    starts: str = "play",
) -> None:
    """Look at the starts of the planners' test seeds."""
    simulator = get_task(task).make_simulator(starts=starts)
    entities = get_task(task).layout
    cubes = tuple(entities.index(name) for name in get_task(task).objects)
    found = [look(simulator, cubes, seed, steps) for seed in tqdm(seed_range("plan_test", episodes))]
    simulator.close()
    table = summary(found)
    print(table)
    if json is not None:
        write_results(json, {"task": task, "steps": steps, **table})


if __name__ == "__main__":
    tyro.cli(main)
