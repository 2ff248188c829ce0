"""The paper's tables for one task: what to train for each row, in resumable pieces, and the table of the results.

Every row of a table has the same training budget in sample-steps (windows times predicted steps), stated with the
CPU-minutes that it took. Each piece (a row and a seed) keeps its result in a file, so that a killed run goes on where
it was.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing as mp
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from pwm_gym.data import load_split
from pwm_gym.data.partial import visible_split
from pwm_gym.dynamics import WorldModel, load_checkpoint
from pwm_gym.errors import look_up
from pwm_gym.evaluation.planning import planning_table, run_episodes
from pwm_gym.evaluation.record import describe_commit
from pwm_gym.evaluation.report import evaluate_rollouts
from pwm_gym.evaluation.rollouts import observed_start
from pwm_gym.files import write_atomically
from pwm_gym.planning import Agent
from pwm_gym.process import prepare_process
from pwm_gym.seeds import seed_range
from pwm_gym.tasks import Task, get_task
from pwm_gym.training import FitConfig, fit
from pwm_gym.training.losses import TrainConfig

__all__ = ["TABLES", "Row", "Table", "row_folder", "run_table", "trained"]

_ABLATION = 500_000  # sample-steps: about ten minutes of the default model on one core
_HEADLINE = 50_000  # twenty minutes to an hour of a network of points on one core
_CERTAIN = {"uncertain": False}  # no table reads what the default model expects to be its error


@dataclass(frozen=True)
class Row:
    """One row of a table."""

    name: str
    model: str = "compact"
    """Kind of world model."""
    settings: Mapping[str, Any] = field(default_factory=lambda: _CERTAIN)
    """Overrides of its hyper-parameters."""
    view: str = "complete"
    """What it sees."""
    training: TrainConfig = field(default_factory=TrainConfig)
    episodes: int = 0
    """Training episodes, evenly chosen; 0 takes all."""
    kinds: tuple[str, ...] = ()
    """Kinds of training episodes; none given takes all."""
    seeds: tuple[int, ...] = (0,)
    plan: int = 0
    """Test seeds of planning that it plans in closed loop in the simulator."""
    paper: str = ""
    """The paper's figure, measured on other data."""


@dataclass(frozen=True)
class Table:
    """A set of rows with one caption."""

    caption: str
    rows: tuple[Row, ...]


def _budget(sample_steps: int, batch: int, *shares: tuple[int, float], **settings: Any) -> TrainConfig:
    """Phases of (horizon, share of the sample-steps), all with one batch size."""
    phases = tuple((h, max(1, round(sample_steps * share / (h * batch))), batch) for h, share in shares)
    return TrainConfig(phases=phases, threads=1, validate_every=10**9, **settings)


_GROWING = ((1, 0.45), (5, 0.3), (15, 0.25))
_QUICK = _budget(_ABLATION, 256, *_GROWING)
_POINTS: dict[str, Any] = {"learning_rate": 2e-3, "loss_points": 64}
_STEPPED = ((1, 0.4), (3, 0.3), (5, 0.3))
_LONG = _budget(_HEADLINE, 32, *_STEPPED, **_POINTS)
_HYBRID = replace(_LONG, loss="hybrid")
_SEEDS = (0, 1, 2)
_SEES = {"rigid": False}
_PLUS = {**_SEES, "entity_features": True}

TABLES: dict[str, Table] = {
    "rollout": Table(
        "Rollouts of the test split (paper, Table 1)",
        (
            Row("3DPWM, compact", seeds=_SEEDS, training=_budget(_HEADLINE, 32, *_GROWING), paper="0.009 / 0.86"),
            Row("3DPWM, paper-small", "paper-small", {}, training=_LONG, seeds=_SEEDS, paper="0.009 / 0.86"),
            Row("ParticleFormer+", "paper-small", _PLUS, "partial", _HYBRID, seeds=_SEEDS, paper="0.080 / 0.61"),
            Row("Partial 3DPWM", "paper-small", _SEES, "partial", _HYBRID, seeds=_SEEDS, paper="0.085 / 0.57"),
        ),
    ),
    "baselines": Table(
        "Other learned baselines (paper, appendix)",
        (
            Row("GBND", "gbnd", {}, "partial", _HYBRID, paper="0.185 / 0.37"),
            Row("ParticleFormer*", "particleformer", {}, "partial", _HYBRID, paper="0.132 / 0.41"),
        ),
    ),
    "register": Table(
        "Register tokens (paper, Table 2)",
        tuple(
            Row(f"{n} register tokens", settings={**_CERTAIN, "registers": n}, training=_QUICK, paper=figure)
            for n, figure in ((0, "0.013"), (1, "0.009"), (2, "0.009"))
        ),
    ),
    "horizon": Table(
        "Supervision horizon (paper, Table 3)",
        (
            *(
                Row(f"H = {h}", training=_budget(_ABLATION, 256, (h, 1.0)), paper=figure)
                for h, figure in ((1, ""), (3, "0.068"), (5, "0.038"), (10, "0.021"), (15, "0.009"))
            ),
            Row("H = 1, 5, 15 growing", training=_QUICK),
        ),
    ),
    "data": Table(
        "Training data",
        (
            Row("all episodes of all kinds", training=_QUICK, plan=20),
            Row("no random switches", training=_QUICK, kinds=("expert", "practice"), plan=20),
            Row("demonstrations alone", training=_QUICK, kinds=("expert", "randomised"), plan=20),
            Row("demonstrations without random switches", training=_QUICK, kinds=("expert",), plan=20),
            *(Row(f"{n} episodes of all kinds", training=_QUICK, episodes=n) for n in (1000, 300, 100)),
        ),
    ),
    "head": Table(
        "What a network of points predicts",
        (
            Row("each entity's rigid motion", "paper-small", {}, training=_LONG),
            Row("each point's velocity", "paper-small", _SEES, training=_LONG),
        ),
    ),
    "arm": Table(
        "What the model knows of the arm",
        (
            Row("joints, kinematics and controller", training=_QUICK),
            Row("the hand's motion alone", settings={**_CERTAIN, "kinematic": False}, training=_QUICK),
        ),
    ),
}
"""Name -> table."""


def run_table(name: str, data: Path, out: Path, task: str = "PickCube", workers: int = 1) -> dict[str, Any]:
    """Train and evaluate what is still missing of a table, and return its rows.

    Args:
        name: of the table.
        data: a data set; its test split is read once a piece.
        out: folder of the pieces.
        task: registered task.
        workers: pieces at once, each on one thread.

    Raises:
        UnknownNameError: no table has this name.
    """
    table = look_up("table", name, TABLES)
    commit = describe_commit()  # of the code that is loaded, which may change on disk meanwhile
    pieces = [_Piece(row, seed, data, out, task, commit) for row in table.rows for seed in row.seeds]
    missing = [p for p in pieces if not p.result.exists()]
    if any(p.row.view == "partial" for p in missing):  # before several processes want it
        for split in ("train", "validation", "test"):
            visible_split(data, split, get_task(task))
    if workers <= 1 or len(missing) <= 1:
        for piece in missing:
            _run(piece)
    else:
        with mp.get_context("spawn").Pool(min(workers, len(missing))) as pool:
            for _ in pool.imap_unordered(_run, missing):
                pass
    rows = []
    for row in table.rows:
        results = [json.loads(p.result.read_text()) for p in pieces if p.row is row]
        rows.append(_joined(row, results, get_task(task).objects[0]))
    return {"caption": table.caption, "rows": rows}


@dataclass(frozen=True)
class _Piece:
    row: Row
    seed: int
    data: Path
    out: Path
    task: str
    commit: str | None

    @property
    def folder(self) -> Path:
        """Named after all that decides the result, so that tables share equal pieces and changed ones are new."""
        row = self.row
        recipe = repr(
            (
                self.task,
                str(self.data),
                row.model,
                sorted(row.settings.items()),
                row.view,
                row.training.describe(),
                row.episodes,
                row.kinds,
                row.plan,
                self.seed,
            )
        )
        return self.out / f"{row.model}-{hashlib.sha256(recipe.encode()).hexdigest()[:12]}"

    @property
    def result(self) -> Path:
        return self.folder / "result.json"


def trained(table: str, row: str, data: Path, out: Path, task: str) -> Path:
    """Checkpoint of a table's row (its first seed), trained where it is not yet.

    Args:
        table: its name.
        row: the row's name.
        data: a data set.
        out: folder of the pieces.
        task: registered task.
    """
    return _fit(_first_piece(table, row, data, out, task))


def row_folder(table: str, row: str, data: Path, out: Path, task: str) -> Path:
    """Folder of a table's row (its first seed), named after all that decides it. Arguments as of :func:`trained`."""
    return _first_piece(table, row, data, out, task).folder


def _first_piece(table: str, row: str, data: Path, out: Path, task: str) -> _Piece:
    found = next(r for r in TABLES[table].rows if r.name == row)
    return _Piece(found, found.seeds[0], data, out, task, describe_commit())


def _fit(piece: _Piece) -> Path:
    """Train one piece, and return its checkpoint."""
    row = piece.row
    config = FitConfig(
        task=piece.task,
        data=(piece.data,),
        out=piece.folder,
        model=row.model,
        settings=dict(row.settings),
        view=row.view,
        episodes=row.episodes,
        kinds=row.kinds,
    )
    # Nothing is chosen by a row's validation, and a network of points takes minutes for it.
    return fit(config, replace(row.training, seed=piece.seed), lambda *_: {}, progress=False)


def _run(piece: _Piece) -> None:
    """Train and evaluate one piece."""
    prepare_process(threads=1)
    row, task = piece.row, get_task(piece.task)
    checkpoint = load_checkpoint(_fit(piece))
    model, training = checkpoint.model, checkpoint.description["training"]
    test = load_split(piece.data, "test", piece.task)
    start = None
    if row.view == "partial":
        start = observed_start(test, visible_split(piece.data, "test", task, test))
    table = evaluate_rollouts(model, task, test, every=10, progress=False, start=start)
    result = {
        "commit": piece.commit,
        "seed": piece.seed,
        "cpu_minutes": training["cpu_minutes_a_process"],
        "sample_steps": sum(h * steps * batch for h, steps, batch in row.training.phases),
        "episodes": sum(training["data"]["episodes"].values()),
        "parameters": sum(p.numel() for p in model.parameters()),  # type: ignore[attr-defined]
        "splits": table,
        "planning": _planning(model, task, row.plan) if row.plan else None,
    }
    write_atomically(piece.result, json.dumps(result, default=float).encode())


def _planning(model: WorldModel, task: Task, episodes: int) -> dict[str, Any]:
    """Closed-loop planning of the test seeds in the simulator."""
    with gym.make(f"pwm/{task.name}Sim-v0") as env:
        runs = run_episodes(env, Agent(model, task.name), seed_range("plan_test", episodes), progress=False)
    return planning_table(runs)


def _joined(row: Row, runs: list[dict[str, Any]], moved: str) -> dict[str, Any]:
    """Mean and spread over the seeds of a row; ``moved`` is the object whose error counts."""
    splits = {}
    for split in runs[0]["splits"]:
        values = {
            "chamfer_l1": [r["splits"][split]["chamfer_l1"] for r in runs],
            "reward_correlation": [r["splits"][split]["reward_correlation"] for r in runs],
        }
        errors = [r["splits"][split]["entities"][moved]["position_mm"] for r in runs]
        if all("60" in e for e in errors):
            values[f"{moved}_at_60_mm"] = [e["60"]["mean"] for e in errors]
        splits[split] = {k: {"mean": float(np.mean(v)), "spread": float(np.std(v))} for k, v in values.items()}
    return {
        "row": row.name,
        "paper, other data": row.paper,
        "commits": sorted({str(r["commit"]) for r in runs}),
        "seeds": len(runs),
        "cpu_minutes": float(np.mean([r["cpu_minutes"] for r in runs])),
        "sample_steps": runs[0]["sample_steps"],
        "episodes": runs[0]["episodes"],
        "parameters": runs[0]["parameters"],
        "splits": splits,
        "planning": [r["planning"] for r in runs if r["planning"] is not None],
    }
