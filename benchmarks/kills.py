"""Kills each long command at random moments, starts it again, and tells whether anything was lost or spoilt.

python benchmarks/kills.py --kills 30 --json benchmarks/results/kills.json
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from safetensors.torch import load_file

from pwm_gym.evaluation import write_results
from pwm_gym.planning import Run

__all__ = ["JOBS", "Job", "Outcome", "kill_often"]

_EARLIEST = 0.4  # of an undisturbed run's time; before, Python imports
_TIMES = {"minutes", "cpu_minutes_a_process", "seconds", "plan_seconds", "date", "command", "commit"}


@dataclass(frozen=True)
class Job:
    """A command that is killed."""

    args: str
    """Its arguments; ``{out}`` is the folder that it writes to, ``{data}`` a small data set."""
    told: Callable[[Path], Any]
    """What a finished run's folder holds that must be the same however often it was killed."""
    kept: str = ""
    """Pattern of the files that are finished once they are there: no later run may touch them."""


@dataclass
class Outcome:
    """What became of a command that was killed."""

    kills: int
    seconds: float
    """Of an undisturbed run."""
    faults: list[str]
    """What was lost, spoilt or another result; empty where all went well."""


def _bytes_of(pattern: str) -> Callable[[Path], dict[str, str]]:
    """Hashes of a folder's files."""
    return lambda folder: {str(p.relative_to(folder)): _hash(p) for p in sorted(folder.glob(pattern))}


def _weights_of(path: str) -> Callable[[Path], str]:
    """Hash of a network's weights."""
    return lambda folder: _hash(folder / path / "model.safetensors")


def _runs(folder: Path) -> dict[str, Any]:
    """Actions and poses of planned episodes, whose times are never the same."""
    found = {path.name: Run.load(path) for path in sorted(folder.glob("runs/*.npz"))}
    return {name: (run.actions.tolist(), run.poses.tolist()) for name, run in found.items()}


def _json_of(pattern: str) -> Callable[[Path], Any]:
    """JSON results without times."""
    return lambda folder: [_timeless(json.loads(p.read_text())) for p in sorted(folder.glob(pattern))]


def _timeless(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _timeless(item) for key, item in value.items() if key not in _TIMES}
    return [_timeless(item) for item in value] if isinstance(value, list) else value


def _steps(folder: Path) -> int:
    """Environment steps of a policy: what comes after an interruption starts from other scenes."""
    return int(json.loads((folder / "config.json").read_text())["training"]["steps"])


_LOOP = "--phases 1 {steps} 4 --validate-every 1000 --save-every 5 --threads 1 --out {{out}}"
JOBS: Mapping[str, Job] = {
    "collect": Job(
        "collect --episodes 8 --held-out 2 --shard 1 --workers 2 --out {out}", _bytes_of("*.npz"), "*.npz"
    ),
    "train": Job(
        "train --data {data} --arm-steps 40 --error-steps 20 --settings width 16 blocks 1 arm_width 16 "
        + _LOOP.format(steps=150),
        _weights_of("checkpoint"),
    ),
    "train-agent cloning": Job(
        "train-agent --data {data} --episodes 0 " + _LOOP.format(steps=2500), _weights_of(".")
    ),
    "train-agent ppo": Job(
        "train-agent --algo ppo --episodes 0 --out {out} --agent.steps 512 --agent.num-envs 4 --agent.rollout 8 "
        "--agent.width 16 --agent.episode-steps 8 --agent.threads 1 --agent.snapshot-every 32",
        _steps,
    ),
    "train-agent sac": Job(
        "train-agent --algo sac --episodes 0 --out {out} --agent.steps 512 --agent.num-envs 4 --agent.width 16 "
        "--agent.episode-steps 8 --agent.threads 1 --agent.snapshot-every 32",
        _steps,
    ),
    "complete": Job(
        "complete train --shapes 12 " + _LOOP.format(steps=12), _weights_of("checkpoint")
    ),
    "plan": Job(
        "plan --episodes 4 --max-steps 12 --samples 32 --horizon 5 --threads 1 --save {out}/runs --json {out}/a.json",
        _runs,
        "runs/seed-*.npz",
    ),
    "evaluate": Job(
        "evaluate --data {data} --every 5 --no-floors --threads 1 --json {out}/table.json", _json_of("table.json")
    ),
    "rank": Job(
        "rank random expert:0 expert:0.5 --scenes 3 --max-steps 20 --out {out} --json {out}/table.json",
        _json_of("**/result.json"),
        "*/result.json",
    ),
}  # fmt: skip
"""Every command that takes minutes or hours, here on something small."""


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def spoilt(folder: Path) -> list[str]:
    """Files under their final names that cannot be read."""
    readers: dict[str, Callable[[Path], Any]] = {
        ".npz": lambda p: [array.shape for array in np.load(p, allow_pickle=False).values()],
        ".json": lambda p: json.loads(p.read_text()),
        ".safetensors": load_file,
        ".pt": lambda p: torch.load(p, weights_only=True),
        ".zip": lambda p: zipfile.ZipFile(p).testzip(),
    }
    faults = []
    for path in sorted(folder.rglob("*")):
        if path.name.startswith(".") or path.suffix not in readers:
            continue
        try:
            readers[path.suffix](path)
        except Exception as error:
            faults.append(f"{path.name} is spoilt: {type(error).__name__}: {error}")
    return faults


def start(args: Sequence[str]) -> subprocess.Popen[str]:
    """The command in a process group of its own."""
    command = [sys.executable, "-m", "pwm_gym", *args]
    return subprocess.Popen(
        command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


def finish(args: Sequence[str]) -> None:
    """Run a command to its end.

    Raises:
        RuntimeError: with what it said, where it failed.
    """
    process = start(args)
    _, told = process.communicate()
    if process.returncode:
        raise RuntimeError(f"{' '.join(args)} ended with {process.returncode}: {told.strip()[-1500:]}")


def kill_later(args: Sequence[str], seconds: float) -> bool:
    """Start a command and kill it and its workers after ``seconds``; whether it was still at work then."""
    process = start(args)
    try:
        process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return True
    return False


def kill_often(job: Job, kills: int, folder: Path, data: Path, chance: random.Random, tries: int = 3) -> Outcome:
    """Run a command undisturbed, and again with interruptions, and compare.

    Args:
        job: the command.
        kills: how often it is killed; runs that are over before start anew in another folder.
        folder: to write in.
        data: a small data set.
        chance: when it is killed.
        tries: runs that may be over before they are killed, of each kill.
    """
    plain = _args(job, folder / "plain", data)
    begun = time.perf_counter()
    finish(plain)
    seconds, expected = time.perf_counter() - begun, job.told(folder / "plain")
    done, number, faults = 0, 0, []
    while done < kills and number < kills * tries:
        number += 1
        own = folder / f"killed-{number}"
        args, before = _args(job, own, data), {}
        while done < kills and kill_later(args, chance.uniform(_EARLIEST, 1.0) * seconds):
            done += 1
            faults += spoilt(own)
            now = _finished(job, own)
            faults += [f"{name} was changed or lost" for name, told in before.items() if now.get(name) != told]
            before = now
        faults += _ended(job, args, own, before, expected)
    return Outcome(done, seconds, faults)


def _ended(job: Job, args: Sequence[str], own: Path, before: dict[str, str], expected: Any) -> list[str]:
    """Run it to its end; what was lost, spoilt, or another result."""
    try:
        finish(args)
    except RuntimeError as error:
        return [str(error)]
    faults, now = spoilt(own), _finished(job, own)
    faults += [f"{name} was changed or lost" for name, told in before.items() if now.get(name) != told]
    if job.told(own) != expected:
        faults.append("the result is another one than undisturbed")
    return faults


def _args(job: Job, out: Path, data: Path) -> list[str]:
    return job.args.format(out=out, data=data).split()


def _finished(job: Job, folder: Path) -> dict[str, str]:
    return _bytes_of(job.kept)(folder) if job.kept else {}


@dataclass(frozen=True)
class Kills:
    """Kill commands, start them again, and compare with undisturbed runs."""

    kills: int = 30
    """Kills in all, shared by the commands."""
    jobs: tuple[str, ...] = tuple(JOBS)
    """Commands, by name."""
    seed: int = 0
    """Of the moments."""
    json: Path | None = None
    """Where to write the results."""

    def run(self) -> bool:
        """Print the table; whether all ended well."""
        rows: dict[str, Outcome] = {}
        with tempfile.TemporaryDirectory() as name:
            root = Path(name)
            data = root / "data"
            finish(["collect", "--episodes", "4", "--held-out", "2", "--out", str(data)])
            for place, job in enumerate(self.jobs):
                count = self.kills // len(self.jobs) + (place < self.kills % len(self.jobs))
                chance = random.Random(f"{job} {self.seed}")
                rows[job] = kill_often(JOBS[job], count, root / job.replace(" ", "-"), data, chance)
                row = rows[job]
                print(f"  {job:20} {row.seconds:5.1f} s, {row.kills} kills, {len(row.faults)} faults", flush=True)
                for fault in row.faults:
                    print(f"    {fault}", flush=True)
                self._write(rows)
        return not any(row.faults for row in rows.values())

    def _write(self, rows: dict[str, Outcome]) -> None:
        """Write what is known so far."""
        if self.json is not None:
            told = {job: {"kills": r.kills, "seconds": r.seconds, "faults": r.faults} for job, r in rows.items()}
            totals = {
                "kills": sum(r.kills for r in rows.values()),
                "faults": sum(len(r.faults) for r in rows.values()),
            }
            write_results(self.json, {**totals, "commands": told})


if __name__ == "__main__":
    raise SystemExit(0 if tyro.cli(Kills).run() else 1)
