"""Write ``docs/results.md`` from the JSON in ``benchmarks/results``: ``python docs/generate_results.py``.

No figure of that page is typed by hand.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

from pwm_gym.assets.liftable import liftable_objects
from pwm_gym.evaluation.planning import wilson

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "results.md"

_MODELS = {
    "compact": "compact (default)",
    "oracle effector": "compact, true end effector",
    "linear": "linear response, no learning",
    "commanded": "commanded pose, no learning",
    "still": "nothing moves",
}
_LINKS = ("hand", "left_gripper", "right_gripper")
_TABLES = ("rollout", "baselines", "head", "register", "horizon", "data", "arm")
_TASKS = {
    "PickCube": "evaluate_pick_cube",
    "StackCube": "evaluate_stack_cube",
    "PickYCB": "evaluate_pick_ycb",
    "PickYCB, unseen objects": "evaluate_pick_ycb_unseen",
}
_PAPER = {
    "PickCube": "0.009 m and 0.86",
    "StackCube": "0.014 m and 0.83",
    "PickYCB": "0.028 m and 0.85",
    "PickYCB, unseen objects": "none",
}
_PLANNED = {
    "PickCube": "plan_pick_cube",
    "StackCube": "plan_stack_cube",
    "PickYCB": "plan_pick_ycb",
    "PickYCB, unseen objects": "plan_pick_ycb_unseen",
}
_PLAN_MODES = ("closed loop", "open loop", "completed clouds, closed loop")
_INTRO = """# Results

Written by `python docs/generate_results.py` from the JSON files in `benchmarks/results`, each of which holds its
command, machine, commit and date. Errors are of open-loop rollouts of the test split: a model observes three clouds,
then predicts the rest of the episode under its actions. The paper's own figures stand in columns marked "paper, other
data": its episodes, objects and simulator differ, so that they show the order of magnitude and nothing more.

The shipped checkpoint, `panda`, is one model of all three tasks. It was trained on two of them, then on all three:

```
pwm-gym collect --task PickCube --episodes 900 --held-out 60 --practice 0.6
pwm-gym collect --task StackCube --episodes 900 --held-out 60 --practice 0.6
pwm-gym collect --task PickYCB --objects seen --episodes 800 --held-out 60 --practice 0.6
pwm-gym collect --task PickYCB --objects unseen --episodes 20 --held-out 80 --practice 0.4 \\
    --out data-sets/PickYCB-unseen
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/PickCube data-sets/StackCube --out runs/two \\
    --threads 1 --phases 1 2200 384 5 900 192 15 650 128
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/PickCube data-sets/StackCube data-sets/PickYCB \\
    --init runs/two/checkpoint --out runs/three --threads 1 --learning-rate 0.002 \\
    --phases 1 1200 384 5 800 192 15 800 128
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/PickCube data-sets/StackCube data-sets/PickYCB \\
    --init runs/three/checkpoint --out runs/panda --threads 1 --learning-rate 0.002 \\
    --phases 1 1500 384 5 600 192 15 600 128
```
"""
_EARLIER = """# Figures of version 0.1

The tables below are of version 0.1, whose model was PickCube's alone, and of its data (`pwm-gym collect --episodes
3000`, and 1,000 for the tables of short trainings). They are measured anew when their trainings are.
"""
_LIMITS = """## What these figures do not show

- Clouds are complete and come from the simulator's meshes, but for the baselines marked "partial" and the sections on
  completion, where the object is segmented by the simulator's ids: errors of segmentation are not in any row.
- Three tasks, one robot. What a model makes of shapes that it never saw is told for ten objects alone.
- The arm's kinematics and its controller are known to the default model and to no baseline; the table of the arm, where
  it is given, tells what that is worth.
- All rows are trained by Muon and AdamW, the networks of points with a lower learning rate (0.002) than the default
  model (0.003); the paper trains by AdamW alone.
- Training, validation and test differ by seeds alone. Actions are a script's and uniform noise; a planner's own actions
  are seen only in the planning figures.
- Planning success is of seeded episodes of one task; where there are twenty or fewer, the intervals are wide.
  Slow models are planned in for five episodes of 50 steps at most, the learned ones with a third of the samples.
- Trainings of the tables are far shorter than the paper's, and as long for every row of a table in sample-steps, not in
  minutes: a network of points takes many times longer a step than one of entities. What a network of points loses by
  partial clouds is a factor of two here and of nine in the paper, whose training is longer.
"""


def page() -> str:
    """The whole page."""
    parts = [
        _INTRO,
        *(_rollouts(task, name) for task, name in _TASKS.items()),
        _onsets(),
        _long(),
        _calibration(),
        _planned(),
        _EARLIER,
        _planning("planning_default", "Planning with the default model of version 0.1"),
        _planning("table_planning"),
        _planning("table_planning-paper"),
        _planning("table_planners"),
        _planning("table_completed"),
        _completion(),
        _completed_rollouts(),
        *_tables(),
        _speed(),
        _LIMITS,
    ]
    return "\n".join(part.rstrip() + "\n" for part in parts if part)


def _read(name: str) -> dict[str, Any] | None:
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text()) if path.exists() else None


def _source(name: str, result: dict[str, Any]) -> str:
    machine = result["machine"]
    where = machine["gpu"] or f"{machine['cores']} CPU cores"
    link = f"[`{name}.json`](../benchmarks/results/{name}.json)"
    return f"```\n{result['command']}\n```\n\n{link}, {where}, commit {result['commit']}.\n"


def _paragraph(*sentences: str) -> str:
    return textwrap.fill(" ".join(sentences), 118) + "\n"


def _grid(head: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _rollouts(task: str, name: str) -> str:
    result = _read(name)
    if result is None:
        return ""
    objects = [k for k in result["rows"]["compact"]["all"]["entities"] if k not in _LINKS]
    rows = []
    for split in ("all", "expert", "randomised", "practice"):
        for key, label in _MODELS.items():
            row = result["rows"].get(key, {}).get(split)
            if row is None:
                continue
            first = f"{split} ({row['episodes']})" if key == "compact" else ""
            cells = [_number(row["chamfer_l1"], 4), _number(row["reward_correlation"], 3)]
            rows.append([first, label, *cells, *(_at_60(row["entities"][k]) for k in objects)])
    head = ["episodes", "model", "Chamfer L1 (m)", "reward correlation"]
    head += [f"{name} at 60, mean / median (mm)" for name in objects]
    best, floors, told = result["rows"]["compact"]["all"], result["floors"], ""
    if floors:
        told = "\n" + _paragraph(
            f"Floors: fresh points on the true surfaces score {floors['sampling']['chamfer_l1']:.4f} m; the simulator,",
            f"an object moved by 0.5 mm at the start, scores {floors['chaos']['chamfer_l1']:.4f} m.",
            f"The reward read off the true clouds correlates {best['reward_correlation_ceiling']:.3f} with the",
            f"simulator's. Paper, other data: {_PAPER[task]}.",
        )
    return f"## {task}\n\n{_source(name, result)}\n{_grid(head, rows)}{told}"


def _at_60(entity: dict[str, Any]) -> str:
    position = entity["position_mm"].get("60")
    return f"{position['mean']:.1f} / {position['median']:.1f}" if position else "-"


def _onsets() -> str:
    """Whether the default model foresees that an object at rest begins to move."""
    rows = []
    for task, name in _TASKS.items():
        told = ((_read(name) or {}).get("onsets") or {}).get("compact") or {}
        for split, values in told.items():
            for cause, row in values["causes"].items():
                cells = [str(row["count"]), _number(row["median"], 2), f"{row['foreseen']:.0%}"]
                rows.append([f"{task}, {split}", cause, *cells])
    if not rows:
        return ""
    about = _paragraph(
        "An onset is a step in which an object's centre moves by more than 1 mm after one of less than 0.2 mm. The",
        "model starts from the true scene; its error one step later is told as a share of the true way. Foreseen: it",
        "moves the object by more than half of that way.",
    )
    head = ["episodes", "the object is", "onsets", "error over true way, median", "foreseen"]
    return f"## Onsets\n\n{about}\n{_grid(head, rows)}"


def _planned() -> str:
    """Success of the shipped checkpoint in each task, by mode."""
    rows, sources = [], []
    for task, stem in _PLANNED.items():
        for mode in _PLAN_MODES:
            name = f"{stem}_{mode.split()[0]}"
            result = _read(name)
            if result is not None:
                rows.append([task, mode, *_success(result)])
                if task == "PickYCB" and result["objects"]:
                    rows.append([f"{task}, liftable objects alone", mode, *_liftable(result)])
                sources.append(_source(name, result))
    if not rows:
        return ""
    about = _paragraph(
        "MPPI with the default settings, executed in the simulator, at most 100 steps. In closed loop the planner",
        "looks at every step, in open loop at the first scene alone.",
    )
    told = "\n".join(sources)
    return f"## Planning\n\n{told}\n{about}\n{_grid(['task', 'mode', *_HEAD[1:]], rows)}"


def _liftable(result: dict[str, Any]) -> list[str]:
    """Success over the objects that the scripted expert lifts at all."""
    rows = [row for name, row in result["objects"].items() if name in liftable_objects()]
    wins, episodes = sum(row["successes"] for row in rows), sum(row["episodes"] for row in rows)
    low, high = wilson(wins, episodes)
    return [f"{wins} / {episodes}", f"{low:.0%} to {high:.0%}", "", ""]


def _long() -> str:
    result = _read("evaluate_pick_cube")
    mixed = (result or {}).get("long_rollouts", {}).get("mixed_actions")
    if not result or not mixed:
        return ""
    still = result["long_rollouts"]
    rows = [[steps, _number(value, 4)] for steps, value in mixed["chamfer_l1_mean_to_step"].items()]
    zero = ", ".join(f"{name} {value:.3f} mm" for name, value in still["zero_actions_mm"].items())
    about = _paragraph(
        "The expert's and random actions in turn, in segments of 15 to 40 steps; Chamfer distances are averages over",
        "the steps up to the one named.",
    )
    besides = _paragraph(
        f"After {still['steps']} zero actions: {zero} from the start. Under {still['steps']} random ones nothing",
        f"leaves {still['random_actions_m']:.2f} m.",
    )
    table = _grid(["steps", "Chamfer L1 (m)"], rows)
    return f"## Long rollouts\n\n{about}\n{table}\n{besides}\n![Quartiles of the errors](images/long_rollouts.png)\n"


def _calibration() -> str:
    result = _read("evaluate_pick_cube")
    told = ((result or {}).get("rows", {}).get("compact", {}).get("all", {})).get("calibration")
    if not told:
        return ""
    rows = [[name, _number(value, 2)] for name, value in told["rank_correlation"].items()]
    about = _paragraph(
        "Rank correlation (Spearman) of the expected with the real error, over all",
        f"{told['steps']:,} steps of the test demonstrations:",
    )
    picture = "![Expected and real errors in ten bins](images/calibration.png)"
    table = _grid(["entity", "rank correlation"], rows)
    return f"## Does the model know how far off it is?\n\n{about}\n{table}\n{picture}\n"


_HEAD = ["", "successes", "95 % interval", "mean steps of successes", "seconds an action, median"]


def _success(result: dict[str, Any]) -> list[str]:
    low, high = result["interval"]
    return [
        f"{result['successes']} / {result['episodes']}",
        f"{low:.0%} to {high:.0%}",
        _number(result["mean_steps_of_successes"], 0),
        f"{result['plan_seconds']['median']:.2f}",
    ]


def _planning(name: str, title: str = "") -> str:
    """Success of every model and mode of a planning table; ``title`` stands for its caption."""
    result = _read(name)
    if result is None:
        return ""
    rows = []
    for row in result["rows"]:
        rounds = f" x {row['iterations']}" if row["iterations"] > 1 else ""
        label = f"{row['row']}{', partial clouds' if row['partial'] else ''}, {row['samples']}{rounds} samples"
        label += f", {row['max_steps']} steps at most"
        rows += [[label, mode, *_success(outcome)] for mode, outcome in row["modes"].items()]
    commits = sorted({str(mode["commit"]) for row in result["rows"] for mode in row["modes"].values()})
    source = _source(name, {**result, "commit": ", ".join(commits)})
    about = _paragraph(
        f"Planned with horizon {result['rows'][0]['horizon']}, executed in the simulator. In closed loop the planner",
        "looks at every step, in open loop at the first scene alone.",
    )
    table = _grid(["model", *_HEAD], rows)
    return f"## {title or result['caption']}\n\n{source}\n{about}\n{table}{_failures(result['rows'])}"


def _failures(rows: list[dict[str, Any]]) -> str:
    """Every failed seed, with the sheet of the row's failures where one is drawn."""
    lines = []
    for row in rows:
        for mode, outcome in row["modes"].items():
            seeds, sheet = ", ".join(map(str, outcome["failed_seeds"])), outcome.get("picture")
            if seeds:
                lines.append(f"- {row['row']}, {mode}: {f'[{seeds}](images/{sheet})' if sheet else seeds}")
    return "\nFailed seeds:\n\n" + "\n".join(lines) + "\n" if lines else ""


def _completion() -> str:
    result = _read("completion")
    if result is None:
        return ""
    rows = []
    for name, row in result["rows"].items():
        chamfer = [_number(row[cell], 1) for cell in ("chamfer", "partial", "hull", "floor", "centroid_percent")]
        shares = [f"{100 * row['better_than_hull']:.0f} %", _number(row["f_score"], 2), _number(row["error_rank"], 2)]
        rows.append([f"{name} ({len(row['objects'])} objects)", *chamfer, *shares])
    head = ["", "Chamfer x 1000", "what is seen", "its hull", "floor", "centroid, % of size", "better than the hull"]
    about = _paragraph(
        f"New views of meshes, {result['views']} of each, turned at random; lengths in units of the object's longest",
        "side, Euclidean Chamfer distances of 2,048 points, half of both directions' sum. Floor: fresh points of the",
        "true surface. The last column is the rank correlation of the expected with the real error.",
    )
    unseen = result["rows"].get("unseen, clean", {}).get("objects", {})
    each = ", ".join(f"{name} {value:.0f}" for name, value in unseen.items())
    told = f"\n{_paragraph(f'Unseen objects, clean: {each}.')}" if each else ""
    table = _grid([*head, "F-score at 2 %", "knows its error"], rows)
    return f"## Completion\n\n{_source('completion', result)}\n{about}\n{table}{told}"


def _completed_rollouts() -> str:
    result = _read("evaluate_completed")
    if result is None:
        return ""
    labels = {"compact": "complete clouds from the simulator"}
    labels.update({k: f"{k} of the robot" for k in result["rows"] if k.startswith("completed")})
    rows = []
    for split in ("all", "expert", "randomised"):
        for key, label in labels.items():
            row = result["rows"][key][split]
            position = row["entities"]["cube"]["position_mm"]["60"]
            cells = [_number(row["chamfer_l1"], 4), _number(row["reward_correlation"], 3)]
            first = f"{split} ({row['episodes']})" if key == "compact" else ""
            rows.append([first, label, *cells, f"{position['mean']:.1f} / {position['median']:.1f}"])
    head = ["episodes", "the model starts from", "Chamfer L1 (m)", "reward correlation", "cube at 60 (mm)"]
    about = _paragraph(
        "The default model from what perception makes of the first views: the object segmented by the simulator's ids,",
        "cleaned, completed and tracked, the robot from its joint angles; scored against the complete truth.",
    )
    table = _grid(head, rows)
    return f"## Rollouts from completed views\n\n{_source('evaluate_completed', result)}\n{about}\n{table}"


def _tables() -> list[str]:
    names = [f"table_{name}" for name in _TABLES]
    return [_table(name, result) for name in names if (result := _read(name))]


def _table(name: str, result: dict[str, Any]) -> str:
    planned = any(row.get("planning") for row in result["rows"])
    rows = []
    for row in result["rows"]:
        splits = row["splits"]
        cells = [row["row"]]
        cells += [_spread(splits[s]["chamfer_l1"], 4) if s in splits else "-" for s in ("all", "expert", "randomised")]
        correlation = splits["all"].get("reward_correlation")
        cells += [_spread(correlation, 3) if correlation else "-", row["paper, other data"] or "-"]
        cells += [f"{row['episodes']:,}", f"{row['cpu_minutes']:.0f}"]
        cells += [f"{row['sample_steps']:,}", f"{row['parameters'] / 1e6:.2f} M"]
        if planned:
            runs = row["planning"]
            cells.append(f"{runs[0]['successes']} / {runs[0]['episodes']}" if runs else "-")
        rows.append(cells)
    head = ["", "Chamfer L1, all (m)", "expert", "randomised", "reward correlation", "paper, other data"]
    head += ["episodes", "CPU-minutes", "sample-steps", "parameters", *(["planned"] if planned else [])]
    commits = sorted({commit for row in result["rows"] for commit in row["commits"]})  # of its pieces
    source = _source(name, {**result, "commit": ", ".join(commits)})
    return f"## {result['caption']}\n\n{source}\n{_grid(head, rows)}"


def _spread(value: dict[str, float], digits: int) -> str:
    mean, spread = f"{value['mean']:.{digits}f}", value["spread"]
    return f"{mean} ± {spread:.{digits}f}" if spread else mean


def _speed() -> str:
    result = _read("bench_pick_cube")
    if result is None:
        return ""
    rows = [["raw simulator, steps a second", f"{result['simulator_steps_per_second']:,.0f}"]]
    for count, rate in result["model_steps_per_second"].items():
        times = f"{rate:,.0f} ({rate / result['simulator_steps_per_second']:.1f} x)"
        rows.append([f"`make_vec(num_envs={count})`, environment steps a second", times])
    for kind, about in (("rollout", "samples x horizon"), ("plan", "samples x horizon x points of the scene")):
        for size, seconds in result[f"{kind}_seconds"].items():
            rows.append([f"one {kind} of {size} ({about}), seconds", f"{seconds:.3f}"])
    for name, row in result.get("planners", {}).items():
        label = f"MPPI of `{name}` with our model, seconds an action; planning cost at the end"
        rows.append([label, f"{row['seconds']:.3f}; {row['final_cost']:.2f}"])
    for name, stages in result.get("perception", {}).items():
        told = ", ".join(f"{stage} {1e3 * seconds:.0f}" for stage, seconds in stages.items() if stage != "all")
        label = "ray-cast view, 128 x 128" if name == "ray-cast" else f"{name} view to a scene (D455, no SAM3)"
        rows.append([f"{label}, ms", f"{1e3 * stages['all']:.0f}{f' ({told})' if told else ''}"])
    start = result["start"]
    rows.append(["`gym.make` and `reset` in a fresh process", f"{start['seconds']:.1f} s, {start['gib']:.2f} GiB"])
    rows.append(["peak memory of all this, GiB", f"{result['peak_gib']:.2f}"])
    return f"## Speed\n\n{_source('bench_pick_cube', result)}\n{_grid(['what', 'measured'], rows)}"


if __name__ == "__main__":
    PAGE.write_text(page())
