"""The page of one environment, made from the registry, docstrings and results: no task is named here."""

from __future__ import annotations

from pathlib import Path

import measured
from formatting import SUCCESS_HEAD, grid
from task_parts import action_table, entities, facts, observation_table, starting_state, summary, weights

from pwm_gym.costs import StagedCost, get_cost, get_success
from pwm_gym.dynamics.checkpoint import default_checkpoints
from pwm_gym.tasks import Task

IMAGES = Path(__file__).parent / "images"
PLAYERS = Path(__file__).parent / "_static" / "players"
_PLAYER = """```{{raw}} html
<video class="player" controls muted loop playsinline preload="metadata" src="../_static/players/{name}.mp4"></video>
```

Planned in the model and executed in the simulator:
`pwm-gym plan --task {name} --episodes 1{options} --save runs/plans`,
then `pwm-gym view` with `--mp4`, or with `--html` for the same in 3D. Teal is what the model predicted, purple what
happened.{end}
"""
_CLONED = " --planner mppi-fine --samples {samples} --guide runs/{name}-cloned"
_OPTIONS = {
    "AdroitHandDoor": _CLONED.format(samples=8, name="AdroitHandDoor"),
    "AdroitHandRelocate": _CLONED.format(samples=32, name="AdroitHandRelocate") + " --offset 2",
}
_ENDS = {"AdroitHandDoor": " The door stays shut here: plans in the model do not open it yet."}
"""How an episode was planned, and how it ended, where that is not as the other tasks'."""
_ROLLOUT_HEAD = ["episodes", "Chamfer L1 (m)", "reward correlation", "objects at step 60 (mm)", "linear response (m)"]
_MAKE = """```python
import gymnasium as gym
import pwm_gym

env = gym.make("pwm/{name}-v0"{checkpoint})  # the learned model
twin = gym.make("pwm/{name}Sim-v0")  # the simulator
```
"""


def task_page(task: Task) -> str:
    """Markdown of the page, whose links are relative to a folder beside the other pages."""
    checkpoint = "" if task.name in default_checkpoints() else ', checkpoint="my/checkpoint"'
    parts = [
        f"# {task.name}\n\n{task.description}\n",
        picture(task.name),
        _MAKE.format(name=task.name, checkpoint=checkpoint),
        "\n".join(facts(task)) + "\n",
        f"## Action space\n\n{action_table(task)}",
        f"## Observation space\n\n{observation_table(task)}",
        _goal(task),
        "## Entities\n\n" + "\n".join(entities(task)) + "\n",
        f'## Reward\n\nMinus the cost `{task.cost}`, whose terms are in `info["cost_terms"]`:\n',
        weights(get_cost(task.cost).terms),
        _planning(task),
        f"## Starting state\n\n{starting_state(task)}",
        "`twin.reset(seed=s)` is the simulator's own episode of seed s; its `scene()` starts the model: "
        "[environments](../environments.md#simenv).\n",
        _end(task),
        _results(task),
    ]
    return "\n".join(part for part in parts if part)


def picture(name: str) -> str:
    """The task's film and still picture, where they are there."""
    parts = []
    if (PLAYERS / f"{name}.mp4").exists():
        parts.append(_PLAYER.format(name=name, options=_OPTIONS.get(name, ""), end=_ENDS.get(name, "")))
    if (IMAGES / f"{name}.png").exists():
        parts.append(f"![A rollout of {name}: predicted (teal) over true (purple)](../images/{name}.png)\n")
    return "\n".join(parts)


def _goal(task: Task) -> str:
    if task.goal_size:
        return ""
    return "The task has no goal beside its objects: `goal` is empty.\n"


def _planning(task: Task) -> str:
    """Planner and planning cost, stage by stage where it has stages."""
    cost = get_cost(task.plan_cost)
    head = f"## Planning cost\n\nPlanner `{task.planner}` descends `{task.plan_cost}`"
    if not isinstance(cost, StagedCost):
        return f"{head}:\n\n{weights(cost.terms)}"
    stages = [f"### Stage {i}: {stage.name}\n\n{weights(stage.terms)}" for i, stage in enumerate(cost.stages, 1)]
    always = f"a [sequence of stages](../stages.md), of which each that is left costs {cost.price:g}. In every stage:"
    return "\n".join([f"{head}, {always}\n\n{weights(cost.terms)}", *stages])


def _end(task: Task) -> str:
    rule = summary(get_success(task.success))
    told = f" ({rule[0].lower()}{rule[1:].rstrip('.')})" if rule else ""
    return (
        f"## Episode end\n\nSuccess `{task.success}`{told} terminates; `gym.make` truncates after "
        f"{task.max_episode_steps} steps. The scripted expert takes about {task.expert_steps}.\n"
    )


def _results(task: Task) -> str:
    """Planning, rollouts and speed of the task, with the commands that made them."""
    parts = [_planned(task), _rollouts(task), _speed(task)]
    if not any(parts):
        return "## Results\n\nNone are recorded yet.\n"
    about = (
        "## Results\n\nOf the shipped checkpoint; what the figures mean, and all others: [results](../results.md).\n"
    )
    return "\n".join([about, *(part for part in parts if part)])


def _planned(task: Task) -> str:
    found = measured.measurements("plan", task.name)
    if not found:
        return ""
    paper = measured.PAPER_SUCCESS.get(task.name)
    told = f"\nThe paper reports {paper} % in closed loop, on its own episodes and objects.\n" if paper else ""
    table = grid(["planning", *SUCCESS_HEAD[1:]], [measured.plan_cells(m) for m in found])
    return f"### Planning in the simulator\n\n{measured.commands(found)}\n{table}{told}"


def _rollouts(task: Task) -> str:
    found = measured.measurements("evaluate", task.name)
    if not found:
        return ""
    rows = [row for m in found for row in measured.rollout_rows(m)]
    about = "Errors are means over a rollout, of objects mean / median; the linear response learns nothing.\n"
    return f"### Open-loop rollouts\n\n{measured.commands(found)}\n{about}\n{grid(_ROLLOUT_HEAD, rows)}"


def _speed(task: Task) -> str:
    found = measured.measurements("bench", task.name)
    if not found:
        return ""
    rows = []
    for m in found:
        rows.append(["raw simulator", f"{m.result['simulator_steps_per_second']:,.0f}"])
        rates = m.result["model_steps_per_second"]
        rows += [[f"model, `num_envs={count}`", f"{rate:,.0f}"] for count, rate in rates.items()]
    return f"### Speed\n\n{measured.commands(found)}\n{grid(['', 'environment steps a second'], rows)}"
