"""What a newcomer reads of the results: one row a task, and the rows that README once had."""

from __future__ import annotations

import measured
from formatting import SUCCESS_HEAD, grid, number, paragraph
from measured import Measurement
from task_parts import trained_on

from pwm_gym.tasks import TASKS

_ROLLOUT_HEAD = [
    "test episodes",
    "Chamfer L1 (m)",
    "reward correlation",
    "objects at step 60, mean / median (mm)",
    "linear response, no learning (m)",
    "paper, other data",
]
HEADLINE_HEAD = [
    "task",
    "planned, closed loop",
    "paper, other episodes",
    "one action",
    "rollout error, Chamfer L1",
    "reward correlation",
]


def glance() -> str:
    """The section "At a glance" of the results page."""
    planned = [[m.task, *measured.plan_cells(m)] for task in TASKS for m in measured.measurements("plan", task)]
    rollouts = [row for task in TASKS for m in measured.measurements("evaluate", task) for row in _rollouts(m)]
    about = paragraph(
        "Of the shipped checkpoints; commands stand in the sections below. Planned with MPPI and executed in the",
        "simulator; rollouts observe three clouds and predict the rest of an episode. The paper's figures are of its",
        "own episodes, objects and simulator.",
    )
    tables = [grid(HEADLINE_HEAD, headline()), grid(["task", "planning", *SUCCESS_HEAD[1:]], planned)]
    return "\n".join(["## At a glance\n", about, *tables, grid(_ROLLOUT_HEAD, rollouts)])


def headline() -> list[list[str]]:
    """One row a task (and set of objects) that was planned in closed loop from complete clouds."""
    rows = []
    for task in TASKS:
        rolled = {m.objects: m for m in measured.measurements("evaluate", task)}
        for plan in measured.measurements("plan", task):
            whole = plan.objects != "liftable"  # those are a part of the set that another row has
            whole = whole and plan.starts != "play"  # another protocol, of a section of its own
            if plan.result["chunk"] == 1 and plan.result["observation"] == "complete" and whole:
                rows.append(_headline(plan, rolled.get(plan.objects if plan.objects == "unseen" else "")))
    return rows


def _headline(plan: Measurement, rolled: Measurement | None) -> list[str]:
    usual = plan.objects in ("", "seen")
    told = plan.task if usual else f"{plan.task}, {plan.objects} objects"
    if plan.task not in trained_on(plan.task):
        told += ", never trained on"
    if "guide" in plan.result:
        told += ", plans start from a policy's"
    paper = measured.PAPER_SUCCESS.get(plan.task) if usual else None
    cells = [told, f"{plan.result['successes']} of {plan.result['episodes']}", f"{paper} %" if paper else "-"]
    cells.append(f"{plan.result['plan_seconds']['median']:.2f} s")
    if rolled is None:
        return [*cells, "-", "-"]
    row = rolled.result["rows"]["compact"]["all"]
    return [*cells, f"{1e3 * row['chamfer_l1']:.1f} mm", number(row["reward_correlation"], 3)]


def _rollouts(rolled: Measurement) -> list[list[str]]:
    """Rows of a task's splits, the paper's figure beside the first."""
    paper = None if rolled.objects else measured.PAPER_ROLLOUTS.get(rolled.task)
    told = f"{paper[0]:.3f} / {paper[1]:.2f}" if paper else ""
    rows = measured.rollout_rows(rolled)
    return [[f"{rolled.task}, {row[0]}", *row[1:], told if i == 0 else ""] for i, row in enumerate(rows)]
