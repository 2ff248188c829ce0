"""Planning success over seeded episodes (paper, section 4.2)."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from pwm_gym.errors import PwmGymError
from pwm_gym.files import write_atomically
from pwm_gym.planning import Agent, Run, execute
from pwm_gym.scene import Scene
from pwm_gym.schema import read_json
from pwm_gym.seeds import seed_range
from pwm_gym.workers import Workers, work_through

__all__ = [
    "claim_folder",
    "episodes_in",
    "load_runs",
    "plan_episodes",
    "planning_table",
    "run_episodes",
    "run_seeds",
    "save_runs",
    "wilson",
]

_RECIPE = "planned-by.json"


def run_episodes(
    env: gym.Env[Any, Any],
    agent: Agent,
    seeds: Sequence[int],
    max_steps: int = 100,
    chunk: int = 1,
    observe: Callable[[Scene], Scene] | None = None,
    progress: bool = True,
    folder: Path | None = None,
    recipe: Mapping[str, Any] | None = None,
) -> list[Run]:
    """Runs of ``seeds``, as of :func:`pwm_gym.planning.execute`; those that succeed at reset are left out.

    Args:
        env: a twin or model environment.
        agent: plans.
        seeds: of the episodes.
        max_steps: actions of each at most.
        chunk: actions between two looks.
        observe: what the agent sees of a scene.
        progress: whether to show a progress bar.
        folder: as of :func:`run_seeds`.
        recipe: as of :func:`run_seeds`.

    Raises:
        PwmGymError: as of :func:`run_seeds`.
    """

    def run_one(seed: int) -> Run:
        return execute(env, agent, seed, max_steps, chunk, observe)

    return run_seeds(run_one, seeds, progress, folder, recipe)


def run_seeds(
    run_one: Callable[[int], Run],
    seeds: Sequence[int],
    progress: bool = True,
    folder: Path | None = None,
    recipe: Mapping[str, Any] | None = None,
    workers: int | Workers = 1,
) -> list[Run]:
    """Runs of seeds in their order; those that succeed at reset are left out.

    Args:
        run_one: the run of a seed; picklable where there are several workers.
        seeds: of the episodes.
        progress: whether to show a progress bar.
        folder: where each run's record is written as soon as it is over; records that are there are not planned again.
        recipe: all that decides a run, of JSON's types; a folder belongs to one.
        workers: runs at once, each in a process of its own where there are several, or who makes them.

    Raises:
        PwmGymError: the folder's runs were planned by another recipe, or do not tell by which; a process died.
    """
    found: dict[int, Run] = {}
    if folder is not None:
        claim_folder(folder, dict(recipe or {}))
        found = {seed: run for seed in seeds if (run := _recorded(folder, seed)) is not None}
    missing = [seed for seed in seeds if seed not in found]
    with tqdm(total=len(seeds), initial=len(found), unit="episode", disable=not progress, desc="plan") as bar:
        for run in work_through(run_one, missing, workers):
            if folder is not None:
                save_runs([run], folder)
            found[run.seed] = run
            counted = [r for r in found.values() if not r.at_reset]
            bar.update()
            bar.set_postfix(success=f"{sum(r.success for r in counted)}/{len(counted)}")
    return [found[seed] for seed in seeds if not found[seed].at_reset]


def plan_episodes(agent: Agent, episodes: int, objects: str = "", progress: bool = False) -> dict[str, Any]:
    """Table of the test seeds in the simulator, as of :func:`episodes_in`."""
    return planning_table(episodes_in("sim", agent, episodes, objects, progress))


def episodes_in(world: str, agent: Agent, episodes: int, objects: str = "", progress: bool = False) -> list[Run]:
    """Runs of the test seeds, in closed loop.

    Args:
        world: "sim", the simulator, or "model", the shipped world model.
        agent: plans, or acts.
        episodes: how many.
        objects: what the simulator's draw their objects from, where they differ; the task's default if not given.
        progress: whether to show a progress bar.
    """
    task = agent.task
    settings: dict[str, Any] = {"objects": objects or None} if world == "sim" else {}
    env = gym.make(f"pwm/{task.name}{'Sim' if world == 'sim' else ''}-v0", **settings)
    with closing(env):
        return run_episodes(env, agent, seed_range("plan_test", episodes), task.max_episode_steps, progress=progress)


def claim_folder(folder: Path, recipe: dict[str, Any]) -> None:
    """Note by what a folder's runs are planned, or compare with what is noted there.

    Raises:
        PwmGymError: it is another recipe, or the folder holds runs of none.
    """
    path, told = folder / _RECIPE, json.loads(json.dumps(recipe))
    if not path.exists():
        if any(folder.glob(_record("*"))):
            raise PwmGymError(f"{folder} holds runs and no {_RECIPE}; expected another folder")
        write_atomically(path, json.dumps(told, indent=1).encode())
        return
    found = read_json(path, dict[str, Any], PwmGymError)
    if other := sorted(key for key in {*found, *told} if found.get(key) != told.get(key)):
        was, now = ({key: each.get(key) for key in other} for each in (found, told))
        raise PwmGymError(f"{folder} holds runs that were planned with {was}; expected {now}, or another folder")


def _recorded(folder: Path, seed: int) -> Run | None:
    """The record of a seed; None where there is none, or a damaged one."""
    try:
        return load_runs([seed], folder)[0]
    except PwmGymError:
        return None


def save_runs(runs: Sequence[Run], folder: Path) -> None:
    """Write a record of each run to ``folder`` as ``seed-N.npz``."""
    for run in runs:
        run.save(folder / _record(run.seed))


def _record(seed: int | str) -> str:
    return f"seed-{seed}.npz"


def load_runs(seeds: Sequence[int], folder: Path) -> list[Run]:
    """The records of ``seeds`` that :func:`save_runs` wrote to ``folder``.

    Raises:
        PwmGymError: one is missing, truncated or not a run.
    """
    return [Run.load(folder / _record(seed)) for seed in seeds]


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
        "mean_steps_of_successes": float(np.mean([r.steps_to_success for r in wins])) if wins else None,
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
    return {"seed": run.seed, "success": run.success, "steps": run.steps_to_success or run.steps, **ended}


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
