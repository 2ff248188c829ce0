"""Damages files of every kind that the package reads, and tells what does not end in one clear error.

python benchmarks/fuzz.py --files 10000 --json benchmarks/results/fuzz.json
"""

from __future__ import annotations

import random
import resource
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
import tyro
from samples import Sample, make_samples
from tqdm import tqdm

from pwm_gym.errors import PwmGymError
from pwm_gym.evaluation import write_results


@dataclass
class Tally:
    """What became of the damaged files of one kind."""

    files: int = 0
    refused: int = 0
    """Read to one clear error; the rest of the files were read as they are."""
    slowest_seconds: float = 0.0
    failures: list[dict[str, Any]] = field(default_factory=list)
    """Of those that ended otherwise: the seed that makes the file again, and how it ended."""


def try_one(name: str, sample: Sample, whole: bytes, seed: int, tally: Tally) -> None:
    """Read one damaged file; ``whole`` is what it is made from."""
    damaged = sample.damage(whole, random.Random(f"{name} {seed}"))
    sample.path.write_bytes(damaged)
    begun = time.perf_counter()
    try:
        sample.read()
    except (PwmGymError, FileNotFoundError) as error:  # the latter is what says that a named file is not there
        tally.refused += 1
        if not str(error):
            tally.failures.append({"seed": seed, "error": f"{type(error).__name__} without a word"})
    except Exception as error:
        told = {"seed": seed, "error": f"{type(error).__name__}: {error}"[:300]}
        tally.failures.append({**told, "traceback": traceback.format_exc()})
    tally.files += 1
    tally.slowest_seconds = max(tally.slowest_seconds, time.perf_counter() - begun)


def fuzz(files: int, folder: Path, kinds: tuple[str, ...] = (), first: int = 0) -> Iterator[tuple[str, Tally]]:
    """Kind of file and what became of it, once a kind.

    Args:
        files: damaged files in all, shared evenly by the kinds.
        folder: an empty one to write in.
        kinds: those alone whose name begins so; none given takes all.
        first: seed of each kind's first file.
    """
    samples = {k: s for k, s in make_samples(folder).items() if not kinds or k.startswith(kinds)}
    for place, (name, sample) in enumerate(samples.items()):
        count = files // len(samples) + (place < files % len(samples))
        tally, whole = Tally(), sample.path.read_bytes()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sample.read()  # it is whole
            for seed in range(first, first + count):
                try_one(name, sample, whole, seed, tally)
        sample.path.write_bytes(whole)
        yield name, tally


@dataclass(frozen=True)
class Fuzz:
    """Damage files, read them, and tell what does not end in one clear error."""

    files: int = 1000
    """Damaged files in all."""
    kinds: tuple[str, ...] = ()
    """Kinds alone whose name begins so; none given takes all."""
    first: int = 0
    """Seed of each kind's first file."""
    json: Path | None = None
    """Where to write the results."""

    def run(self) -> bool:
        """Print the table; whether all ended well."""
        torch.set_num_threads(1)
        rows: dict[str, Any] = {}
        with tempfile.TemporaryDirectory() as folder, tqdm(total=self.files, unit="file") as bar:
            for name, tally in fuzz(self.files, Path(folder), self.kinds, self.first):
                rows[name] = tally
                bar.update(tally.files)
        print(f"  {'':34} {'files':>6} {'refused':>8} {'failed':>7} {'slowest':>8}")
        for name, row in rows.items():
            slowest = f"{row.slowest_seconds:.2f} s"
            print(f"  {name:34} {row.files:6} {row.refused:8} {len(row.failures):7} {slowest:>8}")
        failed = [(name, failure) for name, row in rows.items() for failure in row.failures]
        different = {(name, failure["error"].partition(":")[0]): failure for name, failure in failed}
        for (name, _), failure in different.items():
            print(f"\n{name}, seed {failure['seed']}\n{failure.get('traceback', failure['error'])}")
        if self.json is not None:
            write_results(self.json, self._result(rows))
        return not failed

    def _result(self, rows: dict[str, Tally]) -> dict[str, Any]:
        kinds = {
            name: {
                "files": row.files,
                "refused": row.refused,
                "slowest_seconds": row.slowest_seconds,
                "failures": [{key: failure[key] for key in ("seed", "error")} for failure in row.failures],
            }
            for name, row in rows.items()
        }
        return {
            "files": sum(row.files for row in rows.values()),
            "refused": sum(row.refused for row in rows.values()),
            "failed": sum(len(row.failures) for row in rows.values()),
            "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
            "kinds": kinds,
        }


if __name__ == "__main__":
    raise SystemExit(0 if tyro.cli(Fuzz).run() else 1)
