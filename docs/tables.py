"""Sections of the results page on the tables of models, on completion and on speed."""

from __future__ import annotations

from typing import Any

from formatting import SUCCESS_HEAD, grid, number, paragraph, read, section, source, success

_TABLES = ("rollout", "baselines", "head", "register", "horizon", "data", "arm")
_LATER = (
    "rollout",
    "planning",
    "planning_paper",
    "baselines",
    "register",
    "register_points",
    "horizon",
    "horizon_points",
    "data",
    "data_points",
)
_LONG_TASKS = {"MugCleanup": "mug_cleanup", "Coffee": "coffee", "CoffeePreparation": "coffee_preparation"}
_TASKS = {"StackCube": "stack_cube", "PickYCB": "pick_ycb", "MugCleanup": "mug_cleanup"}
_REGISTERS = ("0 register tokens", "1 register tokens", "2 register tokens")
_HORIZONS = ("H = 3", "H = 5", "H = 10", "H = 15")
_PAPER = {  # Chamfer L1 of its Tables 2 and 3
    ("register", "PickYCB"): dict(zip(_REGISTERS, ("0.052", "0.028", "0.027"), strict=True)),
    ("register", "MugCleanup"): dict(zip(_REGISTERS, ("0.178", "0.022", "0.020"), strict=True)),
    ("horizon", "PickYCB"): dict(zip(_HORIZONS, ("0.161", "0.117", "0.044", "0.028"), strict=True)),
    ("horizon", "MugCleanup"): dict(zip(_HORIZONS, ("0.102", "0.036", "0.028", "0.022"), strict=True)),
}
_MUJOCO_TASKS = {
    "FetchReach": "fetch_reach",
    "FetchPush": "fetch_push",
    "FetchPickAndPlace": "fetch_pick_and_place",
    "FetchSlide": "fetch_slide",
    "OGBenchCubeSingle": "ogbench_cube_single",
    "OGBenchCubeDouble": "ogbench_cube_double",
    "AdroitHandDoor": "adroit_hand_door",
    "AdroitHandRelocate": "adroit_hand_relocate",
}
_TWO_ARM_TASKS = {"TwoArmBoxCleanup": "two_arm_box_cleanup", "TwoArmDrawerCleanup": "two_arm_drawer_cleanup"}


def planning_table(name: str, title: str = "") -> str:
    """Success of every model and mode of a planning table; ``title`` stands for its caption."""
    result = read(name)
    if result is None:
        return ""
    rows = []
    for row in result["rows"]:
        rounds = f" x {row['iterations']}" if row["iterations"] > 1 else ""
        label = f"{row['row']}{', partial clouds' if row['partial'] else ''}, {row['samples']}{rounds} samples"
        label += f", {row['max_steps']} steps at most"
        rows += [[label, mode, *success(outcome)] for mode, outcome in row["modes"].items()]
    commits = sorted({str(mode["commit"]) for row in result["rows"] for mode in row["modes"].values()})
    told = source(name, {**result, "commit": ", ".join(commits)})
    about = paragraph(
        f"Planned with horizon {result['rows'][0]['horizon']}, executed in the simulator. In closed loop the planner",
        "looks at every step, in open loop at the first scene alone.",
    )
    table = grid(["model", *SUCCESS_HEAD], rows)
    return f"## {title or result['caption']}\n\n{told}\n{about}\n{table}{_failures(result['rows'])}"


def _failures(rows: list[dict[str, Any]]) -> str:
    """Every failed seed, with the sheet of the row's failures where one is drawn."""
    lines = []
    for row in rows:
        for mode, outcome in row["modes"].items():
            seeds, sheet = ", ".join(map(str, outcome["failed_seeds"])), outcome.get("picture")
            if seeds:
                lines.append(f"- {row['row']}, {mode}: {f'[{seeds}](images/{sheet})' if sheet else seeds}")
    return "\nFailed seeds:\n\n" + "\n".join(lines) + "\n" if lines else ""


def completion() -> str:
    """Errors of the completion network."""
    result = read("completion")
    if result is None:
        return ""
    rows = []
    for name, row in result["rows"].items():
        chamfer = [number(row[cell], 1) for cell in ("chamfer", "partial", "hull", "floor", "centroid_percent")]
        shares = [f"{100 * row['better_than_hull']:.0f} %", number(row["f_score"], 2), number(row["error_rank"], 2)]
        rows.append([f"{name} ({len(row['objects'])} objects)", *chamfer, *shares])
    head = ["", "Chamfer x 1000", "what is seen", "its hull", "floor", "centroid, % of size", "better than the hull"]
    about = paragraph(
        f"New views of meshes, {result['views']} of each, turned at random; lengths in units of the object's longest",
        "side, Euclidean Chamfer distances of 2,048 points, half of both directions' sum. Floor: fresh points of the",
        "true surface. The last column is the rank correlation of the expected with the real error.",
    )
    unseen = result["rows"].get("unseen, clean", {}).get("objects", {})
    each = ", ".join(f"{name} {value:.0f}" for name, value in unseen.items())
    told = f"\n{paragraph(f'Unseen objects, clean: {each}.')}" if each else ""
    table = grid([*head, "F-score at 2 %", "knows its error"], rows)
    return f"## Completion\n\n{source('completion', result)}\n{about}\n{table}{told}"


def completed_rollouts() -> str:
    """Rollouts from what perception makes of views."""
    result = read("evaluate_completed")
    if result is None:
        return ""
    labels = {"compact": "complete clouds from the simulator"}
    labels.update({k: f"{k} of the robot" for k in result["rows"] if k.startswith("completed")})
    rows = []
    for split in ("all", "expert", "randomised"):
        for key, label in labels.items():
            row = result["rows"][key][split]
            position = row["entities"]["cube"]["position_mm"]["60"]
            cells = [number(row["chamfer_l1"], 4), number(row["reward_correlation"], 3)]
            first = f"{split} ({row['episodes']})" if key == "compact" else ""
            rows.append([first, label, *cells, f"{position['mean']:.1f} / {position['median']:.1f}"])
    head = ["episodes", "the model starts from", "Chamfer L1 (m)", "reward correlation", "cube at 60 (mm)"]
    about = paragraph(
        "The default model from what perception makes of the first views: the object segmented by the simulator's ids,",
        "cleaned, completed and tracked, the robot from its joint angles; scored against the complete truth.",
    )
    table = grid(head, rows)
    return f"## Rollouts from completed views\n\n{source('evaluate_completed', result)}\n{about}\n{table}"


def all_tables() -> list[str]:
    """The tables of trainings that are there."""
    names = [f"table_{name}" for name in _TABLES]
    return [_table(name, result) for name in names if (result := read(name))]


def task_tables() -> list[str]:
    """The tables of trainings and of planning that are there of the tasks after the first."""
    found = []
    for task, suffix in {**_TASKS, **_MUJOCO_TASKS}.items():
        for table in _LATER:
            name = f"table_{table}_{suffix}"
            if (result := read(name)) is not None:
                title = f"{task}: {result['caption'][0].lower()}{result['caption'][1:]}"
                found.append(planning_table(name, title) if "planning" in table else _table(name, result, title, task))
    return found


def _table(name: str, result: dict[str, Any], title: str = "", task: str = "") -> str:
    """One table; its rows' figures from the paper are PickCube's, where no other ``task`` is named."""
    figures = _PAPER.get((name.removeprefix("table_").split("_")[0], task), {})
    planned = any(row.get("planning") for row in result["rows"])
    rows = []
    for row in result["rows"]:
        splits = row["splits"]
        cells = [row["row"]]
        cells += [_spread(splits[s]["chamfer_l1"], 4) if s in splits else "-" for s in ("all", "expert", "randomised")]
        correlation = splits["all"].get("reward_correlation")
        cells += [_spread(correlation, 3) if correlation else "-"]
        cells += [figures.get(row["row"], "-") if task else row["paper, other data"] or "-"]
        cells += [f"{row['episodes']:,}", f"{row['cpu_minutes']:.0f}"]
        cells += [f"{row['sample_steps']:,}", f"{row['parameters'] / 1e6:.2f} M"]
        if planned:
            runs = row["planning"]
            cells.append(f"{runs[0]['successes']} / {runs[0]['episodes']}" if runs else "-")
        rows.append(cells)
    head = ["", "Chamfer L1, all (m)", "expert", "randomised", "reward correlation", "paper, other data"]
    head += ["episodes", "CPU-minutes", "sample-steps", "parameters", *(["planned"] if planned else [])]
    commits = sorted({commit for row in result["rows"] for commit in row["commits"]})  # of its pieces
    told = source(name, {**result, "commit": ", ".join(commits)})
    return f"## {title or result['caption']}\n\n{told}\n{grid(head, rows)}"


def _spread(value: dict[str, float], digits: int) -> str:
    mean, spread = f"{value['mean']:.{digits}f}", value["spread"]
    return f"{mean} ± {spread:.{digits}f}" if spread else mean


def shared() -> str:
    """One checkpoint of several tasks beside each task's own."""
    result = read("table_shared")
    if result is None:
        return ""
    rows = []
    for row in result["rows"]:
        for task, told in row["tasks"].items():
            splits, label = told["splits"], "shared" if len(row["trained_on"]) > 1 else "its own"
            cells = [number(splits[s]["chamfer_l1"], 4) for s in ("all", "expert")]
            correlation = number(splits["all"]["reward_correlation"], 3)
            rows.append([f"{task}, {label}", *cells, correlation, *success(told["planning"])])
    head = ["checkpoint", "Chamfer L1, all (m)", "expert", "reward correlation", *SUCCESS_HEAD[1:]]
    about = paragraph(
        "The shared checkpoint took as many optimiser steps as the three others together, all from fresh weights and",
        "far fewer than the shipped one: phases `1 900 256 5 420 128 15 420 96` of the three data sets, and a third",
        "of each phase's steps of one. Planned in closed loop.",
    )
    return f"## {result['caption']}\n\n{source('table_shared', result)}\n{about}\n{grid(head, rows)}"


def rates() -> str:
    """Environment steps a second of every task that was timed, beside its simulator's."""
    rows, sources = [], []
    for task, suffix in {"PickCube": "pick_cube", **_TASKS, **_LONG_TASKS, **_MUJOCO_TASKS, **_TWO_ARM_TASKS}.items():
        if (result := read(f"bench_{suffix}")) is not None:
            raw, rate = result["simulator_steps_per_second"], result["model_steps_per_second"]
            cells = [f"{rate[n]:,.0f} ({rate[n] / raw:.1f} x)" for n in ("256", "1024")]
            whole = [seconds for size, seconds in result["plan_seconds"].items() if size.startswith("100 x 10 x ")]
            planned = number(whole[0], 2) if whole else "-"
            rows.append([task, f"{raw:,.0f}", *cells, planned, str(result["machine"]["torch_threads"])])
            sources.append(source(f"bench_{suffix}", result))
    about = paragraph(
        "Environment steps a second in one process, and how many times the raw simulator's; seconds of one plan of 100",
        "samples and 10 steps. Where one thread was used, another process kept the other core busy.",
    )
    head = ["task", "raw simulator", "`make_vec(num_envs=256)`", "`make_vec(num_envs=1024)`", "one plan (s)", "threads"]
    return section("Speed of every task", sources, about, head, rows)


def thinning() -> str:
    """What thinner clouds change and save, of the tasks with the largest ones."""
    rows, sources = [], []
    for task, suffix in _TWO_ARM_TASKS.items():
        if (result := read(f"thinning_{suffix}")) is not None:
            for count, row in result["rows"].items():
                differences = [row["reward_difference_mean"], row["reward_difference_most"]]
                told = [number(value, 4) for value in differences]
                rows.append(
                    [task, count, f"{row['steps_per_second']:,.0f}", *told, number(row["entity_difference_mm"], 2)]
                )
                task = ""
            sources.append(source(f"thinning_{suffix}", result))
    about = paragraph(
        "Clouds come in the order of farthest-point sampling, so that a thinner one is each entity's first points",
        "(`gym.make(..., points=1200)`). The same random actions in the same scenes, in whole and in thinner clouds.",
    )
    head = ["task", "points", "steps a second", "reward differs by", "at most", "entities differ by (mm)"]
    return section("Thinner clouds", sources, about, head, rows)


def speed() -> str:
    """Times of environments, rollouts and plans."""
    result = read("bench_pick_cube")
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
    return f"## Speed\n\n{source('bench_pick_cube', result)}\n{grid(['what', 'measured'], rows)}"
