"""The paper's tables for one task: what to train for each row, in resumable pieces, and the table of the results.

Every row of a table has the same training budget in sample-steps (windows times predicted steps), stated with the
CPU-minutes that it took. Each piece (a row and a seed) keeps its result in a file, so that a killed run goes on where
it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pwm_gym.data import load_split
from pwm_gym.data.partial import visible_split
from pwm_gym.data.simulated import check_objects
from pwm_gym.dynamics import load_checkpoint
from pwm_gym.errors import look_up
from pwm_gym.evaluation.planning import plan_episodes
from pwm_gym.evaluation.report import evaluate_rollouts
from pwm_gym.evaluation.rollouts import observed_start
from pwm_gym.experiments.pieces import Piece, run_pieces
from pwm_gym.planning import Agent
from pwm_gym.process import prepare_process
from pwm_gym.tasks import get_task
from pwm_gym.training import FitConfig, fit
from pwm_gym.training.losses import TrainConfig
from pwm_gym.workers import Workers

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

    def shorten(self, scale: float, seeds: int = 0) -> Row:
        """The row with ``scale`` times the training steps, and the first of its ``seeds`` alone; 0 takes all."""
        phases = tuple((h, max(1, round(scale * steps)), batch) for h, steps, batch in self.training.phases)
        return replace(self, training=replace(self.training, phases=phases), seeds=self.seeds[: seeds or None])


@dataclass(frozen=True)
class Table:
    """A set of rows with one caption."""

    caption: str
    rows: tuple[Row, ...]

    def choose(self, names: Sequence[str] = ()) -> tuple[Row, ...]:
        """The rows called ``names``, or all.

        Raises:
            UnknownNameError: listing the known ones.
        """
        known = {row.name: row for row in self.rows}
        return tuple(look_up("row of the table", name, known) for name in names) if names else self.rows


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
_POINTWISE = {"rigid": False}
_SMALL: dict[str, Any] = {"model": "paper-small"}
_REGISTERS = ((0, "0.013"), (1, "0.009"), (2, "0.009"))
_HORIZONS = ((1, ""), (3, "0.068"), (5, "0.038"), (10, "0.021"), (15, "0.009"))

TABLES: dict[str, Table] = {
    "rollout": Table(
        "Rollouts of the test split (paper, Table 1)",
        (
            Row(
                name="3DPWM, compact",
                training=_budget(_HEADLINE, 32, *_GROWING),
                seeds=_SEEDS,
                paper="0.009 / 0.86",
            ),
            Row(
                name="3DPWM, paper-small",
                model="paper-small",
                settings={},
                training=_LONG,
                seeds=_SEEDS,
                paper="0.009 / 0.86",
            ),
            Row(
                name="ParticleFormer+",
                model="paper-small",
                settings={**_POINTWISE, "entity_features": True},
                view="partial",
                training=_HYBRID,
                seeds=_SEEDS,
                paper="0.080 / 0.61",
            ),
            Row(
                name="Partial 3DPWM",
                model="paper-small",
                settings=_POINTWISE,
                view="partial",
                training=_HYBRID,
                seeds=_SEEDS,
                paper="0.085 / 0.57",
            ),
        ),
    ),
    "baselines": Table(
        "Other learned baselines (paper, appendix)",
        (
            Row(name="GBND", model="gbnd", settings={}, view="partial", training=_HYBRID, paper="0.185 / 0.37"),
            Row(
                name="ParticleFormer*",
                model="particleformer",
                settings={},
                view="partial",
                training=_HYBRID,
                paper="0.132 / 0.41",
            ),
        ),
    ),
    "register": Table(
        "Register tokens (paper, Table 2)",
        tuple(
            Row(name=f"{n} register tokens", settings={**_CERTAIN, "registers": n}, training=_QUICK, paper=figure)
            for n, figure in _REGISTERS
        ),
    ),
    "register-points": Table(
        "Register tokens of paper-small (paper, Table 2)",
        tuple(
            Row(name=f"{n} register tokens", settings={"registers": n}, training=_LONG, paper=figure, **_SMALL)
            for n, figure in _REGISTERS
        ),
    ),
    "horizon": Table(
        "Supervision horizon (paper, Table 3)",
        (
            *(
                Row(name=f"H = {h}", training=_budget(_ABLATION, 256, (h, 1.0)), paper=figure)
                for h, figure in _HORIZONS
            ),
            Row(name="H = 1, 5, 15 growing", training=_QUICK),
        ),
    ),
    "horizon-points": Table(
        "Supervision horizon of paper-small (paper, Table 3)",
        tuple(
            Row(
                name=f"H = {h}",
                settings={},
                training=_budget(_HEADLINE, 32, (h, 1.0), **_POINTS),
                paper=figure,
                **_SMALL,
            )
            for h, figure in _HORIZONS
        ),
    ),
    "data": Table(
        "Training data",
        (
            Row(name="all episodes of all kinds", training=_QUICK, plan=20),
            Row(name="no random switches", training=_QUICK, kinds=("expert", "practice"), plan=20),
            Row(name="demonstrations alone", training=_QUICK, kinds=("expert", "randomised"), plan=20),
            Row(name="demonstrations without random switches", training=_QUICK, kinds=("expert",), plan=20),
            *(Row(name=f"{n} episodes of all kinds", training=_QUICK, episodes=n) for n in (1000, 300, 100)),
        ),
    ),
    "data-points": Table(
        "Training data of paper-small",
        (
            Row(name="all episodes of all kinds", settings={}, training=_LONG, **_SMALL),
            Row(name="no random switches", settings={}, training=_LONG, kinds=("expert", "practice"), **_SMALL),
        ),
    ),
    "head": Table(
        "What a network of points predicts",
        (
            Row(name="each entity's rigid motion", model="paper-small", settings={}, training=_LONG),
            Row(name="each point's velocity", model="paper-small", settings=_POINTWISE, training=_LONG),
        ),
    ),
    "arm": Table(
        "What the model knows of the arm",
        (
            Row(name="joints, kinematics and controller", training=_QUICK),
            Row(name="the hand's motion alone", settings={**_CERTAIN, "kinematic": False}, training=_QUICK),
        ),
    ),
}
"""Name -> table."""


def run_table(
    name: str,
    data: Path,
    out: Path,
    task: str = "PickCube",
    workers: int | Workers = 1,
    objects: str = "",
    rows: Sequence[str] = (),
    scale: float = 1.0,
    seeds: int = 0,
) -> dict[str, Any]:
    """Train and evaluate what is still missing of a table, and return its rows; progress is printed.

    Args:
        name: of the table.
        data: a data set; its test split is read once a piece.
        out: folder of the pieces.
        task: registered task.
        workers: pieces at once, each on one thread, or who makes them.
        objects: what planned episodes draw their objects from, as of :meth:`pwm_gym.tasks.Task.make_simulator`; "" for
            the task's default.
        rows: names of the table's rows; none given takes all.
        scale: share of the table's training steps that each row takes.
        seeds: how many of each row's seeds are trained; 0 takes all.

    Raises:
        UnknownNameError: no table has this name, or no row of it.
        PwmGymError: the task has no such objects.
    """
    table = look_up("table", name, TABLES)
    check_objects(get_task(task), objects)
    chosen = [row.shorten(scale, seeds) for row in table.choose(rows)]
    pieces = [_piece(row, seed, data, out, task, objects) for row in chosen for seed in row.seeds]
    if any(row.view == "partial" for row in chosen) and not all(p.result.exists() for p in pieces):
        for split in ("train", "validation", "test"):  # before several processes want it
            visible_split(data, split, get_task(task))
    results = iter(run_pieces(pieces, workers))
    joined = [_joined(row, [next(results) for _ in row.seeds], get_task(task).objects) for row in chosen]
    return {"caption": table.caption, "rows": joined}


def _piece(row: Row, seed: int, data: Path, out: Path, task: str, objects: str = "") -> Piece:
    """One row and seed; the ``objects`` count where it plans."""
    recipe = (
        task,
        str(data),
        row.model,
        sorted(row.settings.items()),
        row.view,
        row.training.describe(),
        row.episodes,
        row.kinds,
        row.plan,
        seed,
        *([objects] if objects and row.plan else []),
    )
    make = partial(_evaluated, row, seed, data, task, objects)
    return Piece(f"{row.name}, seed {seed}", row.model, repr(recipe), out, make)


def trained(table: str, row: str, data: Path, out: Path, task: str, scale: float = 1.0) -> Path:
    """Checkpoint of a table's row (its first seed), trained where it is not yet.

    Args:
        table: its name.
        row: the row's name.
        data: a data set.
        out: folder of the pieces.
        task: registered task.
        scale: share of the table's training steps.
    """
    (found,) = TABLES[table].choose([row])
    folder = row_folder(table, row, data, out, task, scale)
    return _fit(found.shorten(scale), found.seeds[0], data, task, folder)


def row_folder(table: str, row: str, data: Path, out: Path, task: str, scale: float = 1.0) -> Path:
    """Folder of a table's row (its first seed), named after all that decides it. Arguments as of :func:`trained`."""
    (found,) = TABLES[table].choose([row])
    return _piece(found.shorten(scale), found.seeds[0], data, out, task).folder


def _fit(row: Row, seed: int, data: Path, task: str, folder: Path) -> Path:
    """Train one row with one seed, and return its checkpoint."""
    config = FitConfig(
        task=task,
        data=(data,),
        out=folder,
        model=row.model,
        settings=dict(row.settings),
        view=row.view,
        episodes=row.episodes,
        kinds=row.kinds,
    )
    # Nothing is chosen by a row's validation, and a network of points takes minutes for it.
    return fit(config, replace(row.training, seed=seed), lambda *_: {}, progress=False)


def _evaluated(row: Row, seed: int, data: Path, task_name: str, objects: str, folder: Path) -> dict[str, Any]:
    """Train and evaluate one row with one seed."""
    prepare_process(threads=1)
    task = get_task(task_name)
    checkpoint = load_checkpoint(_fit(row, seed, data, task_name, folder))
    model, training = checkpoint.model, checkpoint.description["training"]
    test = load_split(data, "test", task_name)
    start = None
    if row.view == "partial":
        start = observed_start(test, visible_split(data, "test", task, test))
    return {
        "seed": seed,
        "cpu_minutes": training["cpu_minutes_a_process"],
        "sample_steps": sum(h * steps * batch for h, steps, batch in row.training.phases),
        "episodes": sum(training["data"]["episodes"].values()),
        "parameters": sum(p.numel() for p in model.parameters()),  # type: ignore[attr-defined]
        "splits": evaluate_rollouts(model, task, test, every=10, progress=False, start=start),
        "planning": plan_episodes(Agent(model, task.name), row.plan, objects) if row.plan else None,
    }


def _joined(row: Row, runs: list[dict[str, Any]], objects: Sequence[str]) -> dict[str, Any]:
    """Mean and spread over the seeds of a row, with the errors of each of the ``objects``."""
    splits = {}
    for split in runs[0]["splits"]:
        values = {
            "chamfer_l1": [r["splits"][split]["chamfer_l1"] for r in runs],
            "chamfer_l1_entity_mean": [r["splits"][split]["chamfer_l1_entity_mean"] for r in runs],
            "reward_correlation": [r["splits"][split]["reward_correlation"] for r in runs],
        }
        for moved in objects:
            errors = [r["splits"][split]["entities"][moved]["position_mm"] for r in runs]
            if all("60" in e for e in errors):
                values[f"{moved}_at_60_mm"] = [e["60"]["mean"] for e in errors]
        known = {k: [x for x in v if x is not None] for k, v in values.items()}
        splits[split] = {k: {"mean": float(np.mean(v)), "spread": float(np.std(v))} for k, v in known.items() if v}
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
