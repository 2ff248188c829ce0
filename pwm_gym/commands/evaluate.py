"""``pwm-gym evaluate``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pwm_gym.data import Dataset
    from pwm_gym.planning import Run
    from pwm_gym.scene import RigidState
    from pwm_gym.tasks import Task

__all__ = ["Evaluate"]

_WITHOUT_LEARNING = ("still", "commanded", "linear")


@dataclass(frozen=True)
class Evaluate:
    """Roll a checkpoint out on a data set's test split, beside baselines, an oracle end effector and floors.

    With ``--table``, train and evaluate every row of one of the paper's tables instead; what is there already is kept.
    """

    task: str = "PickCube"
    """Registered task."""
    data: Path = Path("data-sets/PickCube")
    """Folder of a data set; the baseline without learning is fitted on its training split."""
    checkpoint: str = "default"
    """A folder or a shipped checkpoint's name."""
    split: str = "test"
    """Which split."""
    every: int = 1
    """Chamfer distances are measured at each n-th step; all other metrics at every one."""
    completer: str | None = None
    """Rows that start from completed views instead of the truth: a completion checkpoint, "default" or "hull"."""
    sensor: str = "ideal"
    """Sensor model of those views: ideal or d455."""
    floors: bool = True
    """Whether to measure the floors, which needs the simulator."""
    long: int = 0
    """Episodes of 300 steps of expert and random actions in turn, made in the simulator, for long rollouts."""
    pictures: Path | None = None
    """Folder for pictures (PNG): expected against real errors, and the errors of the long rollouts over time; of tables
    of planning, the failed episodes."""
    table: str | None = None
    """rollout, baselines, register, horizon, data, head, arm, planning, planners or completed."""
    full: bool = False
    """Tables of planning: whether the fast models plan 100 episodes instead of 20."""
    members: tuple[str, ...] = ()
    """Tables of planning: only these of its rows, by name; none given takes all."""
    out: Path = Path("runs/tables")
    """Folder of a table's trainings and results."""
    workers: int = 1
    """Trainings of a table at once, each on one thread."""
    json: Path | None = None
    """Where to write the results."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Print the table and write the results."""
        if self.table is not None:
            self._table(self.table)
            return
        from pwm_gym.data import load_split
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.evaluation import evaluate_rollouts, long_rollouts, write_results
        from pwm_gym.process import prepare_process
        from pwm_gym.tasks import get_task
        from pwm_gym.training import fit_baseline

        prepare_process(self.threads)
        if self.pictures is not None:
            self.pictures.mkdir(parents=True, exist_ok=True)
        task = get_task(self.task)
        dataset = load_split(self.data, self.split, task.name)
        checkpoint = load_checkpoint(resolve(self.checkpoint, task.name))
        rows = {checkpoint.kind: evaluate_rollouts(checkpoint.model, task, dataset, every=self.every)}
        rows["oracle effector"] = evaluate_rollouts(checkpoint.model, task, dataset, oracle=True, every=self.every)
        training = load_split(self.data, "train", task.name)
        for name in _WITHOUT_LEARNING:
            rows[name] = evaluate_rollouts(fit_baseline(name, task, training), task, dataset, every=self.every)
        if self.completer is not None:
            for view, start in _completed_starts(task, dataset, self.completer, self.sensor).items():
                rows[f"completed, {view}"] = evaluate_rollouts(
                    checkpoint.model, task, dataset, every=self.every, start=start
                )
        floors = _floors(task, dataset) if self.floors else {}
        _print(task, rows, floors)
        self._calibration(task, rows[checkpoint.kind])
        long = long_rollouts(checkpoint.model, dataset)
        print(f"300 zero actions, moved at the end (mm): {long['zero_actions_mm']}")
        print(f"300 random actions: farthest {long['random_actions_m']:.2f} m, finite: {long['finite']}")
        curves = self._long(task, checkpoint.model, dataset) if self.long else {}
        if self.json is not None:
            results = {
                "split": self.split,
                "every": self.every,
                "checkpoint": checkpoint.description["training"]["data"],
            }
            write_results(
                self.json,
                {**results, "rows": rows, "floors": floors, "long_rollouts": {**long, "mixed_actions": curves}},
            )

    def _long(self, task: Task, model: Any, dataset: Dataset) -> dict[str, Any]:
        """Errors along long rollouts, drawn where asked for."""
        from pwm_gym.evaluation.long import error_curves, mixed_episodes
        from pwm_gym.viewer import draw_quartiles

        simulator = task.simulator()
        curves = error_curves(model, mixed_episodes(simulator, task, dataset.clouds, self.long))
        simulator.close()
        for length, value in curves.mean_chamfer.items():
            print(f"{length} steps of mixed actions: Chamfer L1 {value:.4f} m on average")
        if self.pictures is not None:
            panels = {f"{name}: position error (mm)": v for name, v in curves.positions.items()}
            picture = draw_quartiles(panels, f"{task.name}: {self.long} rollouts of mixed actions")
            picture.save(self.pictures / "long_rollouts.png")
        return curves.summary()

    def _calibration(self, task: Task, row: dict[str, Any]) -> None:
        """Print how well a model's expected errors rank its real ones, and draw them where asked for."""
        told = row["all"].get("calibration") if "all" in row else None
        if told is None:
            return
        ranks = ", ".join(f"{name} {value:.2f}" for name, value in told["rank_correlation"].items())
        print(f"rank correlation of expected and real errors: {ranks}")
        if self.pictures is not None:
            from pwm_gym.viewer import draw_calibration

            picture = draw_calibration(told["bins"], f"{task.name}: does the model know how far off it is?")
            picture.save(self.pictures / "calibration.png")

    def _table(self, name: str) -> None:
        from pwm_gym.errors import look_up
        from pwm_gym.evaluation import write_results
        from pwm_gym.experiments import TABLES, run_planning_table, run_table
        from pwm_gym.experiments.members import PLANNING_TABLES, PlanningTable
        from pwm_gym.process import prepare_process

        chosen = look_up("table", name, {**TABLES, **PLANNING_TABLES})
        if isinstance(chosen, PlanningTable):
            prepare_process(self.threads)
            draw = None if self.pictures is None else partial(_draw_failures, self.pictures)
            planning = run_planning_table(chosen, self.data, self.out, self.task, self.full, self.members, draw)
            _print_planning(planning)
            if self.json is not None:
                write_results(self.json, {"table": name, **planning})
            return
        table = run_table(name, self.data, self.out, self.task, self.workers)
        print(table["caption"])
        for row in table["rows"]:
            cells = [f"{split} {_spread(row['splits'][split]['chamfer_l1'])}" for split in row["splits"]]
            correlation = _spread(row["splits"]["all"]["reward_correlation"], 3)
            print(f"  {row['row']:36s} CD L1: {', '.join(cells)}; corr {correlation}")
            print(
                f"  {'':36s} {row['cpu_minutes']:.0f} CPU-minutes, {row['sample_steps']:,} sample-steps, "
                f"{row['seeds']} seeds; paper, other data: {row['paper, other data'] or '-'}"
            )
        if self.json is not None:
            write_results(self.json, {"table": name, **table})


def _draw_failures(pictures: Path, row: str, mode: str, runs: Sequence[Run]) -> str:
    """One sheet of failed runs; returns its path in the folder of pictures."""
    from pwm_gym.commands.view import twin_record
    from pwm_gym.viewer import draw_overlays

    records = []
    for run in runs:
        record = twin_record(run, "")
        told = f"seed {run.seed}: {run.steps} steps, clouds {1e3 * record.error[-1]:.0f} mm apart at the end"
        records.append(replace(record, subtitle=told))
    name = re.sub(r"[^a-z0-9]+", "-", f"{row} {mode}".lower())
    path = Path("failures") / f"{name}.png"
    (pictures / path).parent.mkdir(parents=True, exist_ok=True)
    sheet = draw_overlays(records, f"{row}, {mode}: failed episodes, the world model over the simulator")
    sheet.save(pictures / path, optimize=True)
    return str(path)


def _print_planning(table: dict[str, Any]) -> None:
    print(table["caption"])
    for row in table["rows"]:
        print(f"  {row['row']}, {row['samples']} samples")
        for mode, result in row["modes"].items():
            low, high = result["interval"]
            steps = result["mean_steps_of_successes"]
            print(
                f"    {mode:14s} {result['successes']:3d}/{result['episodes']} ({low:.0%} to {high:.0%}), "
                f"{'-' if steps is None else f'{steps:.0f}'} steps, {result['plan_seconds']['median']:.2f} s an action"
            )


def _completed_starts(task: Task, dataset: Dataset, completer: str, sensor: str) -> dict[str, RigidState]:
    """What perception makes of the episodes' first views, from each of three places."""
    from pwm_gym.cameras.viewpoints import CAMERA_SCALE, VIEWPOINTS
    from pwm_gym.completion import build_completer
    from pwm_gym.evaluation.rollouts import completed_start
    from pwm_gym.perception.build import build_observer

    simulator = task.simulator()
    meshes = simulator.meshes()
    simulator.close()
    made = build_completer(completer)
    starts = {}
    for name, camera in VIEWPOINTS.items():
        view = camera.resize(CAMERA_SCALE)
        look = build_observer(task, dataset.layout, meshes, dataset.clouds, made, view, sensor)
        starts[name] = completed_start(dataset, look)
    return starts


def _floors(task: Task, dataset: Dataset) -> dict[str, Any]:
    from pwm_gym.evaluation.floors import chaos_floor, sampling_floor
    from pwm_gym.scene import sample_clouds

    simulator = task.simulator()
    fresh = sample_clouds(simulator.meshes(), task.layout, task.cloud_seed + 1000)
    demonstrations = dataset.of_kinds(("expert", "randomised"))
    floors = {
        "sampling": sampling_floor(demonstrations, fresh),
        "chaos": chaos_floor(simulator, task, demonstrations),
    }
    simulator.close()
    return floors


def _print(task: Task, rows: dict[str, Any], floors: dict[str, Any]) -> None:
    """The table on the terminal: metres for Chamfer, millimetres for the object."""
    splits = list(next(iter(rows.values())))
    for split in splits:
        episodes = next(iter(rows.values()))[split]["episodes"]
        print(f"\n{task.name}, {split}: {episodes} test episodes")
        header = f"{task.objects[0]} @10   @30   @60  median@60  last (mm)"
        print(f"  {'model':16s} {'CD L1':>8s} {'entities':>9s} {'corr':>6s}   {header}")
        for name, table in rows.items():
            row = table[split]
            position = row["entities"][task.objects[0]]["position_mm"]
            cells = [f"{position[k]['mean']:5.1f}" if k in position else "    -" for k in ("10", "30", "60")]
            middle = f"{position['60']['median']:5.1f}" if "60" in position else "    -"
            print(
                f"  {name:16s} {row['chamfer_l1']:8.4f} {row['chamfer_l1_entity_mean']:9.4f} "
                f"{_number(row['reward_correlation'])}   {' ' * len(task.objects[0])} {' '.join(cells)}      {middle} "
                f"     {position['last']['mean']:5.1f}"
            )
        ceiling = next(iter(rows.values()))[split]["reward_correlation_ceiling"]
        print(f"  reward correlation on true clouds (ceiling): {_number(ceiling)}")
    for name, floor in floors.items():
        print(f"{name} floor: {floor}")


def _spread(value: dict[str, float], digits: int = 4) -> str:
    """Mean and, where there are several seeds, their standard deviation."""
    spread = f" +- {value['spread']:.{digits}f}" if value["spread"] else ""
    return f"{value['mean']:.{digits}f}{spread}"


def _number(value: float | None) -> str:
    return "     -" if value is None else f"{value:6.3f}"
