"""Planning success over seeded episodes (paper, section 4.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from pwm_gym.errors import PwmGymError
from pwm_gym.planning import Agent, Run, execute
from pwm_gym.scene import Scene

__all__ = ["load_runs", "planning_table", "run_episodes", "save_runs", "wilson"]


def run_episodes(
    env: gym.Env[Any, Any],
    agent: Agent,
    seeds: Sequence[int],
    max_steps: int = 100,
    chunk: int = 1,
    observe: Callable[[Scene], Scene] | None = None,
    progress: bool = True,
) -> list[Run]:
    """Runs of ``seeds``; those that succeed at reset are left out. Arguments as of :func:`pwm_gym.planning.execute`."""
    runs = []
    with tqdm(seeds, unit="episode", disable=not progress, desc="plan") as bar:
        for seed in bar:
            run = execute(env, agent, seed, max_steps, chunk, observe)
            if not run.at_reset:
                runs.append(run)
            bar.set_postfix(success=f"{sum(r.success for r in runs)}/{len(runs)}")
    return runs


def save_runs(runs: Sequence[Run], folder: Path) -> None:
    """Write a record of each run to ``folder`` as ``seed-N.npz``."""
    for run in runs:
        run.save(folder / f"seed-{run.seed}.npz")


def load_runs(seeds: Sequence[int], folder: Path) -> list[Run]:
    """The records of ``seeds`` that :func:`save_runs` wrote to ``folder``.

    Raises:
        PwmGymError: one is missing, truncated or not a run.
    """
    return [Run.load(folder / f"seed-{seed}.npz") for seed in seeds]


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """95 % Wilson interval of a success rate."""
    if trials == 0:
        return 0.0, 1.0
    rate = successes / trials
    middle = (rate + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials))
    return max(0.0, middle - half), min(1.0, middle + half)


def planning_table(runs: Sequence[Run]) -> dict[str, Any]:
    """Success rate with its interval, steps and latencies (seconds an action) of ``runs``, by object and by stage.

    Raises:
        PwmGymError: there are none.
    """
    if not runs:
        raise PwmGymError("no run is left to tell of; expected at least one seed that is not a success at reset")
    wins = [r for r in runs if r.success]
    latencies = np.array([t for r in runs for t in r.plan_seconds])
    return {
        "episodes": len(runs),
        "successes": len(wins),
        "interval": wilson(len(wins), len(runs)),
        "mean_steps_of_successes": float(np.mean([r.steps for r in wins])) if wins else None,
        "plan_seconds": {
            "median": float(np.median(latencies)),
            "mean": float(latencies.mean()),
            "p95": float(np.quantile(latencies, 0.95)),
        },
        "failed_seeds": [r.seed for r in runs if not r.success],
        "runs": [_row(r) for r in runs],
        "objects": _by_object(runs),
        "stages": _by_stage(runs),
    }


def _row(run: Run) -> dict[str, Any]:
    ended = {"stage": run.stages[-1]} if run.stages else {}
    return {"seed": run.seed, "success": run.success, "steps": run.steps, **ended}


def _by_stage(runs: Sequence[Run]) -> dict[str, int]:
    """Episodes that got past each stage, where the planner's cost is a sequence of them."""
    names = runs[0].settings.get("stages", []) if runs[0].stages else []
    ends = [names.index(run.stages[-1]) for run in runs] if names else []
    return {name: sum(end > k for end in ends) for k, name in enumerate(names[:-1])}


def _by_object(runs: Sequence[Run]) -> dict[str, dict[str, int]]:
    """Episodes and successes of each object, where the episodes' objects differ."""
    found: dict[str, dict[str, int]] = {}
    for run in runs:
        assets = zip(run.start.layout, run.start.assets, strict=False)  # none, where a scene names no assets
        name = " ".join(asset for entity, asset in assets if not entity.driven)
        row = found.setdefault(name, {"episodes": 0, "successes": 0})
        row["episodes"] += 1
        row["successes"] += run.success
    return dict(sorted(found.items())) if len(found) > 1 else {}
