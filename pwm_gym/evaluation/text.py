"""Tables as they are printed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pwm_gym.evaluation.floors import in_units_of_chaos
from pwm_gym.tasks import Task

__all__ = ["planning_text", "report_text", "shared_text", "trained_text"]

_COLUMNS = ("10", "30", "60", "half", "last")


def report_text(task: Task, rows: Mapping[str, Any], onsets: Mapping[str, Any], floors: Mapping[str, Any]) -> str:
    """The table of rollouts: scene, every object, and onsets, for each split; floors below.

    Args:
        task: names the objects.
        rows: row -> split -> metrics, as of :func:`~pwm_gym.evaluation.report.evaluate_rollouts`.
        onsets: row -> split -> onset errors.
        floors: name -> floor.
    """
    lines = []
    for split, first in next(iter(rows.values())).items():
        tables = {name: table[split] for name, table in rows.items()}
        chaos = floors.get("chaos, practice" if split == "practice" else "chaos", {}).get("objects", {})
        lines += ["", f"{task.name}, {split}: {first['episodes']} test episodes"]
        lines += _scene_lines(tables)
        lines.append(f"  reward correlation on true clouds (ceiling): {_cell(first['reward_correlation_ceiling'], 3)}")
        for name in task.objects:
            lines += _object_lines(name, tables, chaos.get(name))
        lines += _onset_lines({name: table[split] for name, table in onsets.items() if split in table})
    lines += [f"{name} floor: {_floor(floor)}" for name, floor in floors.items() if floor is not None]
    return "\n".join(lines)


def _scene_lines(tables: Mapping[str, Any]) -> list[str]:
    """Chamfer distances of the whole scene and its entities' mean, and the reward's correlation."""
    lines = [f"  {'model':20s} {'CD L1':>8s} {'entities':>9s} {'corr':>7s}"]
    for name, row in tables.items():
        correlation = _cell(row["reward_correlation"], 3)
        lines.append(f"  {name:20s} {row['chamfer_l1']:8.4f} {row['chamfer_l1_entity_mean']:9.4f} {correlation:>7s}")
    return lines


def _object_lines(name: str, tables: Mapping[str, Any], chaos: Mapping[str, Any] | None) -> list[str]:
    """One object's errors: position, rotation, joint where it has one, and position in units of chaos."""
    kinds = [k for k in next(iter(tables.values()))["entities"][name] if k != "rotation_deg"]
    head = "".join(f" {'@' + k if k.isdigit() else k:>8s}" for k in _COLUMNS)
    lines = [f"  {name}: mean error after steps{head}   median, last   turned, last (deg)"]
    for row, table in tables.items():
        entity = table["entities"][name]
        for kind in kinds:
            error = entity[kind]
            cells = "".join(f" {_cell(error.get(k, {}).get('mean'), 1):>8s}" for k in _COLUMNS)
            turned = entity["rotation_deg"]["last"]["mean"] if kind == "position_mm" else None
            last = f"{error['last']['median']:14.1f} {_cell(turned, 1):>12s}"
            lines.append(f"    {row:20s} {kind.replace('_', ' '):14s}{cells} {last}")
        if chaos is not None:
            units = in_units_of_chaos(entity["position_mm"], chaos["position_mm"])
            cells = "".join(f" {_cell(units.get(k), 1):>8s}" for k in _COLUMNS)
            lines.append(f"    {row:20s} {'in chaos':14s}{cells}")
    return lines


def _onset_lines(tables: Mapping[str, Any]) -> list[str]:
    """Onset errors of every model, and of each cause."""
    if not tables:
        return []
    first = next(iter(tables.values()))
    counts = ", ".join(f"{cause} {told['count']}" for cause, told in first["causes"].items())
    lines = [f"  onsets: {first['count']} ({counts}); median error over the true way, share foreseen"]
    for row, told in tables.items():
        each = ", ".join(f"{cause} {part['foreseen']:.0%}" for cause, part in told["causes"].items())
        lines.append(f"    {row:20s} {told['median']:6.2f} {told['foreseen']:6.0%}   foreseen: {each}")
    return lines


def _floor(floor: Mapping[str, Any]) -> str:
    """One floor in a line."""
    told = [f"{k} {v:.4f}" for k, v in floor.items() if isinstance(v, float)]
    for name, part in floor.get("objects", {}).items():
        if "position_mm" in part:
            last = part["position_mm"]["last"]
            told.append(f"{name} ends {last['mean']:.1f} mm off (median {last['median']:.1f})")
    return ", ".join(told)


def trained_text(table: Mapping[str, Any]) -> str:
    """A table whose rows were trained."""
    lines = [table["caption"]]
    for row in table["rows"]:
        cells = [f"{split} {spread(values['chamfer_l1'])}" for split, values in row["splits"].items()]
        correlation = row["splits"].get("all", {}).get("reward_correlation")
        told = "-" if correlation is None else spread(correlation, 3)
        lines.append(f"  {row['row']:36s} CD L1: {', '.join(cells)}; corr {told}")
        lines.append(
            f"  {'':36s} {row['cpu_minutes']:.0f} CPU-minutes, {row['sample_steps']:,} sample-steps, "
            f"{row['seeds']} seeds; paper, other data: {row['paper, other data'] or '-'}"
        )
    return "\n".join(lines)


def planning_text(table: Mapping[str, Any]) -> str:
    """A table of planning."""
    lines = [table["caption"]]
    for row in table["rows"]:
        lines.append(f"  {row['row']}, {row['samples']} samples")
        lines += [f"    {mode:14s} {_success(result)}" for mode, result in row["modes"].items()]
    return "\n".join(lines)


def shared_text(table: Mapping[str, Any]) -> str:
    """Checkpoints of several tasks and of one, task by task."""
    lines = [table["caption"]]
    for row in table["rows"]:
        lines.append(f"  {row['row']} (trained on {', '.join(row['trained_on'])})")
        for task, result in row["tasks"].items():
            chamfer = ", ".join(f"{split} {values['chamfer_l1']:.4f}" for split, values in result["splits"].items())
            planned = "" if result["planning"] is None else f"; closed loop {_success(result['planning'])}"
            lines.append(f"    {task:20s} CD L1: {chamfer}{planned}")
    return "\n".join(lines)


def _success(result: Mapping[str, Any]) -> str:
    low, high = result["interval"]
    steps = _cell(result["mean_steps_of_successes"], 0)
    rate = f"{result['successes']:3d}/{result['episodes']} ({low:.0%} to {high:.0%})"
    return f"{rate}, {steps} steps, {result['plan_seconds']['median']:.2f} s an action"


def spread(value: Mapping[str, float], digits: int = 4) -> str:
    """Mean and, where there are several seeds, their standard deviation."""
    more = f" +- {value['spread']:.{digits}f}" if value["spread"] else ""
    return f"{value['mean']:.{digits}f}{more}"


def _cell(value: float | None, digits: int) -> str:
    """A number, or a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"
