"""One checkpoint for several tasks against each task's own: rollouts and closed-loop success, task by task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pwm_gym.data import load_split
from pwm_gym.data.simulated import check_objects
from pwm_gym.dynamics import load_checkpoint
from pwm_gym.errors import PwmGymError
from pwm_gym.evaluation.planning import plan_episodes
from pwm_gym.evaluation.report import evaluate_rollouts
from pwm_gym.experiments.pieces import Piece, run_pieces
from pwm_gym.learning import digest
from pwm_gym.planning import Agent
from pwm_gym.process import prepare_process
from pwm_gym.tasks import get_task
from pwm_gym.workers import Workers

__all__ = ["run_shared_table"]

_CAPTION = "One checkpoint for several tasks, and each task's own"


def run_shared_table(
    checkpoints: Sequence[Path],
    tasks: Sequence[str],
    data: Mapping[str, Path],
    out: Path,
    episodes: int = 20,
    workers: int | Workers = 1,
    objects: str = "",
) -> dict[str, Any]:
    """Evaluate every checkpoint on every task that it was trained on; what is there already is kept.

    Args:
        checkpoints: folders; each is a row.
        tasks: registered tasks.
        data: task -> data set, whose test split is rolled out.
        out: folder of the pieces.
        episodes: test seeds of planning that are planned in closed loop; 0 plans none.
        workers: pieces at once, each on one thread, or who makes them.
        objects: what planned episodes draw their objects from, of tasks whose objects differ between episodes; "" for
            each task's default.

    Raises:
        PwmGymError: no checkpoint is given, none knows one of the tasks, or no task has such objects.
    """
    if not checkpoints:
        raise PwmGymError("the table 'shared' has no rows; expected --checkpoints FOLDER FOLDER ...")
    varied = [name for name in tasks if get_task(name).object_sets]
    for name in varied or tasks[:1]:
        check_objects(get_task(name), objects)
    pieces: dict[tuple[Path, str], Piece] = {}
    for folder in checkpoints:
        known = _tasks_of(folder)
        for task in tasks:
            if task in known:
                asked = objects if task in varied else ""
                pieces[folder, task] = _piece(folder, get_task(task).name, data[task], out, episodes, asked)
    if unknown := [task for task in tasks if not any(key[1] == task for key in pieces)]:
        raise PwmGymError(f"none of the checkpoints was trained on {', '.join(unknown)}")
    results = dict(zip(pieces, run_pieces(list(pieces.values()), workers), strict=True))
    rows = [
        {
            "row": str(folder),
            "trained_on": _tasks_of(folder),
            "tasks": {task: results[folder, task] for task in tasks if (folder, task) in results},
        }
        for folder in checkpoints
    ]
    return {"caption": _CAPTION, "rows": rows}


def _tasks_of(folder: Path) -> list[str]:
    """Tasks that a checkpoint was trained on."""
    return list(load_checkpoint(folder).tasks)


def _piece(folder: Path, task: str, data: Path, out: Path, episodes: int, objects: str) -> Piece:
    recipe = (digest(folder), task, str(data), episodes, *([objects] if objects and episodes else []))
    make = partial(_evaluated, folder, task, data, episodes, objects)
    return Piece(f"{folder}, {task}", "shared", repr(recipe), out, make)


def _evaluated(
    checkpoint: Path, task_name: str, data: Path, episodes: int, objects: str, folder: Path
) -> dict[str, Any]:
    """Rollouts of the test split and planning with one checkpoint on one task."""
    prepare_process(threads=1)
    task, model = get_task(task_name), load_checkpoint(checkpoint).model
    splits = evaluate_rollouts(model, task, load_split(data, "test", task_name), every=10, progress=False)
    planning = plan_episodes(Agent(model, task.name), episodes, objects) if episodes else None
    return {"splits": splits, "planning": planning}
