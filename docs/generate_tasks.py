"""Write docs/tasks.md from the registry of tasks: python docs/generate_tasks.py."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pwm_gym.costs import StagedCost, get_cost
from pwm_gym.dynamics import load_checkpoint
from pwm_gym.dynamics.checkpoint import default_checkpoints
from pwm_gym.tasks import Task, get_task

DOCS = Path(__file__).parent
PAGE = DOCS / "tasks.md"
_PANDA = ("PickCube", "StackCube", "PickYCB", "MugCleanup", "Coffee", "CoffeePreparation")
_FETCH = ("FetchReach", "FetchPush", "FetchSlide", "FetchPickAndPlace")
_ADROIT = ("AdroitHandDoor", "AdroitHandRelocate")
_NAMES = (*_PANDA, *_FETCH, *_ADROIT)
_INTRO = """# Tasks

Written by `python docs/generate_tasks.py`. Spaces, rewards and infos that all tasks share:
[environments.md](environments.md); figures: [results.md](results.md); a task of your own: [own_task.md](own_task.md).
"""
_MORE = {
    "PickYCB": "Where its objects come from, and which are kept out of training: [ycb.md](ycb.md).\n",
    "MugCleanup": "In ManiSkill, too: `import pwm_gym.sim.maniskill.scenes` registers `MugCleanup-v1` there.\n",
    "Coffee": "In ManiSkill, too: `import pwm_gym.sim.maniskill.scenes` registers `Coffee-v1` there.\n",
    "CoffeePreparation": "In ManiSkill, too: `import pwm_gym.sim.maniskill.scenes` registers `CoffeePreparation-v1` "
    "there. No model is trained on it: it is made of parts of MugCleanup and Coffee.\n",
    "AdroitHandDoor": "No checkpoint comes with it, and its script explores: it reaches, grasps and pulls, turns the "
    "latch in most episodes and seldom opens the door. The reward is Gymnasium-Robotics' own, whose first term pays "
    "for distance from the handle; planners get a cost of their own.\n",
    "AdroitHandRelocate": "No checkpoint comes with it, and its script explores: it reaches and grasps, lifts the ball "
    "in some episodes and seldom keeps it. The reward is Gymnasium-Robotics' own, whose first term pays for distance "
    "from the ball; planners get a cost of their own.\n",
}


def page() -> str:
    """The page's text."""
    return "\n".join([_INTRO, *(_section(get_task(name)) for name in _NAMES)])


def _section(task: Task) -> str:
    lines = [f"## {task.name}", "", task.description, ""]
    if (DOCS / "images" / f"{task.name}.png").exists():
        lines += [f"![A rollout: predicted (teal) over true (purple)](images/{task.name}.png)", ""]
    lines += _facts(task)
    lines += ["| entity | points | how it moves |", "|---|---|---|"]
    for entity in task.layout:
        kind = entity.joint.kind
        moves = f"{kind}, on `{entity.joint.parent}`" if entity.joint.parent else kind
        lines.append(f"| `{entity.name}` | {entity.points} | {moves}{', driven' if entity.driven else ''} |")
    for title, name in (("reward (minus the cost)", task.cost), ("planners' cost", task.plan_cost)):
        cost = get_cost(name)
        lines += ["", f"Terms of the {title}, `{name}`: {_terms(cost.terms)}."]
        if isinstance(cost, StagedCost):
            lines += ["", f"It is a [sequence of stages](stages.md); each that is left costs {cost.price:g}:", ""]
            lines += [f"{i}. `{stage.name}`: {_terms(stage.terms)}" for i, stage in enumerate(cost.stages, 1)]
    return "\n".join([*lines, "", _MORE.get(task.name, "")])


def _terms(terms: Mapping[str, tuple[float, Any]]) -> str:
    return ", ".join(f"`{term}` {weight:+.3g}" for term, (weight, _) in terms.items())


def _facts(task: Task) -> list[str]:
    """What is not in the table of entities."""
    goal = f"{task.goal_size} values, metres" if task.goal_size else "none beside its objects"
    facts = [
        f"- `pwm/{task.name}-v0`, `pwm/{task.name}Sim-v0`: {task.layout.points} points, {task.action_size} actions, "
        f"robot `{task.robot.name}`, control period {task.control.period} s",
        f"- goal: {goal}; at most {task.max_episode_steps} steps; the expert takes about {task.expert_steps}",
        f"- success `{task.success}`, grasp rule `{task.grasp}`, planner `{task.planner}`",
    ]
    folder = default_checkpoints().get(task.name)
    if folder is not None:
        tasks = ", ".join(load_checkpoint(folder).seen_tasks)
        facts.append(f"- checkpoint `{folder.name}`, trained on {tasks}")
    if task.object_sets:
        facts.append(f"- sets of objects: {', '.join(f'`{name}`' for name in task.object_sets)}")
    return [*facts, ""]


if __name__ == "__main__":
    PAGE.write_text(page())
