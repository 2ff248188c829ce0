"""Write ``docs/results.md`` from the JSON in ``benchmarks/results``: ``python docs/generate_results.py``.

No figure of that page is typed by hand.
"""

from __future__ import annotations

from typing import Any

from adaptation import adaptation
from agents import guided, learned, ranked
from formatting import ROOT, SUCCESS_HEAD, grid, number, paragraph, read, source, success
from glance import glance
from published import published
from reliability import reliability
from tables import (
    all_tables,
    completed_rollouts,
    completion,
    planning_table,
    rates,
    shared,
    speed,
    task_tables,
    thinning,
)
from trained import TRAINED

from pwm_gym.assets.liftable import liftable_objects
from pwm_gym.evaluation.planning import wilson
from pwm_gym.tasks import get_task

PAGE = ROOT / "docs" / "results.md"

_MODELS = {
    "compact": "compact (default)",
    "oracle effector": "compact, true end effector",
    "linear": "linear response, no learning",
    "commanded": "commanded pose, no learning",
    "still": "nothing moves",
}
_JOINTS = {"joint_mm": "mm", "joint_deg": "degrees"}
_TASKS = {
    "PickCube": "evaluate_pick_cube",
    "StackCube": "evaluate_stack_cube",
    "PickYCB": "evaluate_pick_ycb",
    "PickYCB, unseen objects": "evaluate_pick_ycb_unseen",
    "MugCleanup": "evaluate_mug_cleanup",
    "Coffee": "evaluate_coffee",
    "CoffeePreparation, never trained on": "evaluate_coffee_preparation",
    "FetchReach": "evaluate_fetch_reach",
    "FetchPush": "evaluate_fetch_push",
    "FetchPickAndPlace": "evaluate_fetch_pick_and_place",
    "FetchSlide": "evaluate_fetch_slide",
    "OGBenchCubeSingle": "evaluate_ogbench_cube_single",
    "OGBenchCubeDouble": "evaluate_ogbench_cube_double",
    "AdroitHandDoor": "evaluate_adroit_hand_door",
    "AdroitHandRelocate": "evaluate_adroit_hand_relocate",
    "TwoArmBoxCleanup": "evaluate_two_arm_box_cleanup",
    "TwoArmDrawerCleanup": "evaluate_two_arm_drawer_cleanup",
}
_PAPER = {
    "PickCube": "0.009 m and 0.86",
    "StackCube": "0.014 m and 0.83",
    "PickYCB": "0.028 m and 0.85",
    "PickYCB, unseen objects": "none",
    "MugCleanup": "0.022 m and 0.79",
    "Coffee": "none",
    "CoffeePreparation, never trained on": "none",
    "FetchReach": "none",
    "FetchPush": "none",
    "FetchPickAndPlace": "none",
    "FetchSlide": "none",
    "OGBenchCubeSingle": "none",
    "OGBenchCubeDouble": "none",
    "AdroitHandDoor": "none",
    "AdroitHandRelocate": "none",
    "TwoArmBoxCleanup": "0.022 m and 0.83",
    "TwoArmDrawerCleanup": "0.058 m and 0.77",
}
_PLANNED = {
    "PickCube": "plan_pick_cube",
    "StackCube": "plan_stack_cube",
    "PickYCB": "plan_pick_ycb",
    "PickYCB, liftable objects": "plan_pick_ycb_liftable",
    "PickYCB, unseen objects": "plan_pick_ycb_unseen",
    "MugCleanup": "plan_mug_cleanup",
    "Coffee": "plan_coffee",
    "CoffeePreparation, never trained on": "plan_coffee_preparation",
    "FetchReach": "plan_fetch_reach",
    "FetchPush": "plan_fetch_push",
    "FetchPickAndPlace": "plan_fetch_pick_and_place",
    "FetchSlide": "plan_fetch_slide",
    "OGBenchCubeSingle": "plan_ogbench_cube_single",
    "OGBenchCubeDouble": "plan_ogbench_cube_double",
    "AdroitHandDoor": "plan_adroit_hand_door",
    "AdroitHandRelocate": "plan_adroit_hand_relocate",
    "TwoArmBoxCleanup": "plan_two_arm_box_cleanup",
    "TwoArmDrawerCleanup": "plan_two_arm_drawer_cleanup",
}
_MIXED = ("PickYCB", "PickYCB, unseen objects")  # some of whose objects nothing can lift
_PLAN_MODES = {
    "closed": "closed loop",
    "chunks": "chunks of 20",
    "open": "open loop",
    "completed": "completed clouds, closed loop",
    "completed_open": "completed clouds, open loop",
    "guided": "closed loop, plans start from the cloned policy's",
}
_INTRO = """# Results

Written by `python docs/generate_results.py` from the JSON files in `benchmarks/results`, each of which holds its
command, machine, commit and date. Errors are of open-loop rollouts of the test split: a model observes three clouds,
then predicts the rest of the episode under its actions. The paper's own figures stand in columns marked "paper, other
data": its episodes, objects and simulator differ, so that they show the order of magnitude and nothing more.
"""
_EARLIER = """## Figures of version 0.1

The tables below are of version 0.1, whose model was PickCube's alone, and of its data (`pwm-gym collect --episodes
3000`, and 1,000 for the tables of short trainings). They are measured anew when their trainings are.
"""
_LIMITS = """## What these figures do not show

- Clouds are complete and come from the simulator's meshes, but for the baselines marked "partial" and the sections on
  completion, where the object is segmented by the simulator's ids: errors of segmentation are not in any row.
- Tasks of six robots. What a model makes of shapes that it never saw is told for ten objects alone.
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
        glance(),
        TRAINED,
        *(_rollouts(task, name) for task, name in _TASKS.items()),
        _onsets(),
        _long(),
        _calibration(),
        _planned(),
        published(),
        _cloned(),
        adaptation(),
        learned(),
        ranked(),
        guided(),
        _distractors(),
        *task_tables(),
        _EARLIER,
        planning_table("planning_default", "Planning with the default model of version 0.1"),
        planning_table("table_planning"),
        planning_table("table_planning-paper"),
        planning_table("table_planners"),
        planning_table("table_completed"),
        completion(),
        completed_rollouts(),
        *all_tables(),
        shared(),
        speed(),
        rates(),
        thinning(),
        reliability(),
        _LIMITS,
    ]
    return "\n".join(part.rstrip() + "\n" for part in parts if part)


def _rollouts(task: str, name: str) -> str:
    result = read(name)
    if result is None:
        return ""
    layout = get_task(task.partition(",")[0]).layout
    objects = [e.name for e in layout if not e.driven]
    first_row = result["rows"]["compact"]["all"]["entities"]
    joints = [(k, measure) for k in objects for measure in _JOINTS if measure in first_row[k]]
    halves = [e.name for e in layout if e.loose and "half" in first_row[e.name]["position_mm"]]
    rows = []
    for split in ("all", "expert", "randomised", "practice"):
        for key, label in _MODELS.items():
            row = result["rows"].get(key, {}).get(split)
            if row is None:
                continue
            first = f"{split} ({row['episodes']})" if key == "compact" else ""
            cells = [number(row["chamfer_l1"], 4), number(row["reward_correlation"], 3)]
            cells += [_error(row["entities"][k], "position_mm", "60") for k in objects]
            cells += [_error(row["entities"][k], "position_mm", "half") for k in halves]
            cells += [_error(row["entities"][k], measure, "last") for k, measure in joints]
            rows.append([first, label, *cells])
    head = ["episodes", "model", "Chamfer L1 (m)", "reward correlation"]
    head += [f"{name} at 60, mean / median (mm)" for name in objects]
    head += [f"{name} at half, mean / median (mm)" for name in halves]
    head += [f"{name}'s joint at the end, mean / median ({_JOINTS[measure]})" for name, measure in joints]
    best, floors, told = result["rows"]["compact"]["all"], result["floors"], ""
    if floors:
        told = "\n" + paragraph(
            f"Floors: fresh points on the true surfaces score {floors['sampling']['chamfer_l1']:.4f} m; the simulator,",
            f"an object moved by 0.5 mm at the start, scores {floors['chaos']['chamfer_l1']:.4f} m.",
            f"The reward read off the true clouds correlates {best['reward_correlation_ceiling']:.3f} with the",
            f"simulator's. Paper, other data: {_PAPER[task]}.",
        )
    return f"## {task}\n\n{source(name, result)}\n{grid(head, rows)}{told}"


def _error(entity: dict[str, Any], measure: str, step: str) -> str:
    error = entity.get(measure, {}).get(step)
    return f"{error['mean']:.1f} / {error['median']:.1f}" if error else "-"


def _onsets() -> str:
    """Whether the default model foresees that an object at rest begins to move."""
    rows = []
    for task, name in _TASKS.items():
        told = ((read(name) or {}).get("onsets") or {}).get("compact") or {}
        for split, values in told.items():
            for cause, row in values["causes"].items():
                cells = [str(row["count"]), number(row["median"], 2), f"{row['foreseen']:.0%}"]
                rows.append([f"{task}, {split}", cause, *cells])
    if not rows:
        return ""
    about = paragraph(
        "An onset is a step in which an object's centre moves by more than 1 mm after one of less than 0.2 mm. The",
        "model starts from the true scene; its error one step later is told as a share of the true way. Foreseen: it",
        "moves the object by more than half of that way.",
    )
    head = ["episodes", "the object is", "onsets", "error over true way, median", "foreseen"]
    return f"## Onsets\n\n{about}\n{grid(head, rows)}"


def _planned() -> str:
    """Success of the shipped checkpoint in each task, by mode."""
    rows, sources, sheets = [], [], {}
    for task, stem in _PLANNED.items():
        for suffix, mode in _PLAN_MODES.items():
            name = f"{stem}_{suffix}"
            result = read(name)
            if result is not None:
                rows.append([task, mode, *success(result)])
                if task in _MIXED and result["objects"]:
                    rows.append([f"{task}, those alone that the expert lifts", mode, *_liftable(result)])
                sources.append(source(name, result))
                if "picture" in result:
                    sheets[f"{task}, {mode}"] = result["picture"]
    about = paragraph(
        "MPPI with the default settings, executed in the simulator, at most as many steps as the task allows. In",
        "closed loop the planner looks at every step, in open loop at the first scene alone. The rows of StackCube and",
        "PickYCB were measured with the planning costs of the commits that are named, before ways from above and grips",
        "were sharpened for the long tasks; CoffeePreparation's before its mug was put down as exactly as now. In",
        "chunks the planner looks at every 20th step, and plans the others from what it predicts. PickYCB's objects",
        "are all 48 that training saw, of which the scripted expert lifts 43. In Adroit's tasks the cloned policies",
        "do better alone (below) than the plans that start from theirs: contact of a hand is not foreseen well enough.",
        "Some rows were measured beside other processes, which their seconds show.",
    )
    return _successes("Planning", about, ["task", "mode"], rows, sources) + _failed_sheets(sheets)


def _failed_sheets(sheets: dict[str, str]) -> str:
    """Links to pictures of failed episodes."""
    links = [f"[{label}](images/{path})" for label, path in sheets.items() if (ROOT / "docs/images" / path).exists()]
    return f"\nFailed episodes in pictures: {', '.join(links)}.\n" if links else ""


def _cloned() -> str:
    """Success of policies cloned from the same demonstrations."""
    rows, sources = [], []
    for task, stem in _TASKS.items():
        name = stem.replace("evaluate", "cloned")
        result = read(name)
        if result is not None:
            rows.append([task, *success(result)])
            sources.append(source(name, result))
    about = paragraph(
        "A network from entity poses to actions, trained on the data set's demonstrations up to where they turn random",
        "(`pwm-gym train-agent`), in the planners' test episodes; it sees every step. Adroit's saw more episodes than",
        "its world models: 1,200 of the door (`pwm-gym collect --task AdroitHandDoor --episodes 1200 --held-out 120",
        "--practice 0.3`), and 1,500 with the ball (held out 150).",
    )
    return _successes("Behaviour cloning", about, ["task"], rows, sources)


def _successes(title: str, about: str, head: list[str], rows: list[list[str]], sources: list[str]) -> str:
    """A section of successes, where there are any."""
    told = "\n".join(sources)
    return f"## {title}\n\n{told}\n{about}\n{grid([*head, *SUCCESS_HEAD[1:]], rows)}" if rows else ""


def _distractors() -> str:
    """Planning and predictions among objects that no training saw."""
    name = "table_distractors"
    result = read(name)
    if result is None:
        return ""
    planned, influence = result["planning"], result["influence"]
    low, high = planned["interval"]
    pushed = planned["distractors_pushed_mm"]
    steps, moved = number(planned["mean_steps_of_successes"], 0), influence["own_mm"]["cube"]
    about = paragraph(
        f"PickCube with five more objects on the table, two of them within 8 cm of the cube, in {result['episodes']}",
        f"scenes: {planned['successes']} successes (95 % interval {low:.0%} to {high:.0%}), in {steps} steps on",
        f"average, which push one of the five by {pushed['mean']:.0f} mm on average. Under {result['horizon']} random",
        f"actions the predicted cube ends {moved:.1f} mm from where it does without them, on average.",
    )
    return f"## Distractors\n\n{source(name, result)}\n{about}"


def _liftable(result: dict[str, Any]) -> list[str]:
    """Success over the objects that the scripted expert lifts at all."""
    rows = [row for name, row in result["objects"].items() if name in liftable_objects()]
    wins, episodes = sum(row["successes"] for row in rows), sum(row["episodes"] for row in rows)
    low, high = wilson(wins, episodes)
    return [f"{wins} / {episodes}", f"{low:.0%} to {high:.0%}", "", ""]


def _long() -> str:
    result = read("evaluate_pick_cube")
    mixed = (result or {}).get("long_rollouts", {}).get("mixed_actions")
    if not result or not mixed:
        return ""
    still = result["long_rollouts"]
    rows = [[steps, number(value, 4)] for steps, value in mixed["chamfer_l1_mean_to_step"].items()]
    zero = ", ".join(f"{name} {value:.3f} mm" for name, value in still["zero_actions_mm"].items())
    about = paragraph(
        "The expert's and random actions in turn, in segments of 15 to 40 steps; Chamfer distances are averages over",
        "the steps up to the one named.",
    )
    besides = paragraph(
        f"After {still['steps']} zero actions: {zero} from the start. Under {still['steps']} random ones nothing",
        f"leaves {still['random_actions_m']:.2f} m.",
    )
    table = grid(["steps", "Chamfer L1 (m)"], rows)
    return f"## Long rollouts\n\n{about}\n{table}\n{besides}\n![Quartiles of the errors](images/long_rollouts.png)\n"


def _calibration() -> str:
    result = read("evaluate_pick_cube")
    told = ((result or {}).get("rows", {}).get("compact", {}).get("all", {})).get("calibration")
    if not told:
        return ""
    rows = [[name, number(value, 2)] for name, value in told["rank_correlation"].items()]
    about = paragraph(
        "Rank correlation (Spearman) of the expected with the real error, over all",
        f"{told['steps']:,} steps of the test demonstrations:",
    )
    picture = "![Expected and real errors in ten bins](images/calibration.png)"
    table = grid(["entity", "rank correlation"], rows)
    return f"## Does the model know how far off it is?\n\n{about}\n{table}\n{picture}\n"


if __name__ == "__main__":
    PAGE.write_text(page())
