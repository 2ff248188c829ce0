"""Which objects the scripted expert lifts in PickSingleYCB, and how often."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from pwm_gym.assets.folder import AssetFolder
from pwm_gym.assets.known import object_grasps
from pwm_gym.assets.names import is_unseen
from pwm_gym.assets.trials import YcbTrials
from pwm_gym.errors import PwmGymError
from pwm_gym.files import write_atomically
from pwm_gym.skills import PickObject

__all__ = ["liftable_objects", "liftable_record", "measure_liftable"]

_FIRST_SEED = 100


def liftable_record() -> dict[str, Any]:
    """The committed record of :func:`measure_liftable`; an object that it does not list was not measured."""
    return dict(json.loads(resources.files("pwm_gym.assets").joinpath("ycb_liftable.json").read_text()))


def liftable_objects(least: int = 1) -> tuple[str, ...]:
    """YCB objects that the scripted expert lifted, in alphabetical order.

    Args:
        least: number of successes in five tries.
    """
    rows = liftable_record()["objects"]
    return tuple(sorted(name for name, row in rows.items() if row["successes"] >= least))


def measure_liftable(
    folder: AssetFolder,
    out: Path,
    objects: Iterable[str] = (),
    tries: int = 5,
    max_steps: int = 150,
) -> dict[str, Any]:
    """Let the expert pick each object, and write what came of it; objects that ``out`` has already are kept.

    Args:
        folder: of the objects.
        out: JSON file of the record.
        objects: names; none for all of the folder.
        tries: episodes of an object, of the seeds 100, 101, ...
        max_steps: longest episode, in control steps.

    Raises:
        PwmGymError: ``out`` was measured with other settings, or an object is not in the folder.
    """
    settings = {"tries": tries, "max_steps": max_steps, "first_seed": _FIRST_SEED, "robot": "panda"}
    record = _begun(out, settings)
    names = tuple(objects) or folder.names()
    trials = YcbTrials(folder)
    try:
        for name in tqdm([name for name in names if name not in record["objects"]], desc="picking"):
            expert = PickObject(object_grasps(folder, name))
            steps = [trials.steps(name, _FIRST_SEED + i, expert, max_steps) for i in range(tries)]
            record["objects"][name] = _row(name, steps)
            record["summary"] = _summary(record["objects"])
            write_atomically(out, (json.dumps(record, indent=1) + "\n").encode())
    finally:
        trials.close()
    return record


def _begun(out: Path, settings: dict[str, Any]) -> dict[str, Any]:
    record = {
        "command": "pwm-gym assets liftable",
        "task": "ManiSkill PickSingleYCB-v1, pd_ee_delta_pose, its own success (object at the goal, robot static)",
        "settings": settings,
        "summary": {},
        "objects": {},
    }
    if out.is_file():
        record = json.loads(out.read_text())
        if record["settings"] != settings:
            raise PwmGymError(f"{out} was measured with {record['settings']}; expected {settings}")
    return record


def _row(name: str, steps: list[int | None]) -> dict[str, Any]:
    """Successes of an object, and the steps that each try took (null: it failed)."""
    split = "unseen" if is_unseen(name) else "seen"
    return {"split": split, "successes": sum(step is not None for step in steps), "steps": steps}


def _summary(rows: dict[str, Any]) -> dict[str, Any]:
    lifted = [row for row in rows.values() if row["successes"]]
    lengths = [step for row in lifted for step in row["steps"] if step is not None]
    tries = sum(len(row["steps"]) for row in lifted)
    return {
        "objects": len(rows),
        "liftable": len(lifted),
        "success_of_liftable": round(len(lengths) / tries, 3) if tries else None,
        "mean_steps": round(float(np.mean(lengths)), 1) if lengths else None,
        "longest": max(lengths, default=None),
    }
