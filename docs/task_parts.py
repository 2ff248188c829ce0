"""Parts of the pages on tasks, read off the registry and the shipped checkpoints."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from docstrings import plain
from formatting import grid

from pwm_gym.costs import StagedCost, get_cost
from pwm_gym.dynamics import Checkpoint, load_checkpoint
from pwm_gym.dynamics.checkpoint import default_checkpoints
from pwm_gym.envs.common import action_space, observation_space
from pwm_gym.planning import Posture
from pwm_gym.robots import Channel
from pwm_gym.tasks import Task

_CHANNELS = {
    "translation": "change of the tool's place along x, y, z",
    "rotation": "turn of the tool about x, y, z",
    "yaw": "turn of the tool about the vertical",
    "gripper": "1 opens the gripper, -1 shuts it",
    "finger": "target of a finger",
    "joint": "target of a joint",
}
_UNITS = {"translation": "m", "rotation": "rad", "yaw": "rad"}
_MEANINGS = {
    "points": "metres, in the frame of the robot's base",
    "velocity": "x_t - x_{t-1}, metres a control step",
    "previous_velocity": "x_{t-1} - x_{t-2}, metres a control step",
    "goal": "what the task asks for, metres",
}


def facts(task: Task) -> list[str]:
    """What is not in the table of entities, as bullets."""
    goal = f"{task.goal_size} values, metres" if task.goal_size else "none beside its objects"
    lines = [
        f"- `pwm/{task.name}-v0`, `pwm/{task.name}Sim-v0`: {task.layout.points} points, {task.action_size} actions, "
        f"robot `{task.robot.name}`, control period {task.control.period} s",
        f"- goal: {goal}; at most {task.max_episode_steps} steps; the expert takes about {task.expert_steps}",
        f"- success `{task.success}`, grasp rule `{task.grasp}`, planner `{task.planner}`",
    ]
    if task.postures:
        fixed = Posture(task.control, task.postures).fixed
        sought = [f"`{name}`" for k, name in enumerate(task.robot.action_names) if k not in fixed]
        lines.append(f"- hands keep their posture by themselves; a plan seeks {', '.join(sought)}")
    folder = default_checkpoints().get(task.name)
    if folder is not None:
        lines.append(f"- checkpoint `{folder.name}`, trained on {', '.join(trained_on(task.name))}")
    if task.object_sets:
        lines.append(f"- sets of objects: {', '.join(f'`{name}`' for name in task.object_sets)}")
    if task.starts:
        lines.append(f"- starts: {', '.join(f'`{name}`' for name in task.starts)}")
    return lines


@cache
def _loaded(folder: Path) -> Checkpoint:
    return load_checkpoint(folder)


def trained_on(task: str) -> tuple[str, ...]:
    """Tasks that the task's shipped checkpoint has seen; none where it has no checkpoint."""
    folder = default_checkpoints().get(task)
    return () if folder is None else tuple(_loaded(folder).seen_tasks)


def entities(task: Task) -> list[str]:
    """A table of the task's entities."""
    lines = ["| entity | points | how it moves |", "|---|---|---|"]
    for entity in task.layout:
        kind = entity.joint.kind
        moves = f"{kind}, on `{entity.joint.parent}`" if entity.joint.parent else kind
        lines.append(f"| `{entity.name}` | {entity.points} | {moves}{', driven' if entity.driven else ''} |")
    return lines


def reward(task: Task) -> str:
    """Terms of the default reward, in one sentence."""
    return f"Terms of the reward (minus the cost), `{task.cost}`: {_terms(get_cost(task.cost).terms)}."


def planning_cost(task: Task) -> list[str]:
    """Terms of the planners' cost, and its stages where it has some."""
    cost = get_cost(task.plan_cost)
    lines = [f"Terms of the planners' cost, `{task.plan_cost}`: {_terms(cost.terms)}."]
    if isinstance(cost, StagedCost):
        lines += ["", f"It is a [sequence of stages](stages.md); each that is left costs {cost.price:g}:", ""]
        lines += [f"{i}. `{stage.name}`: {_terms(stage.terms)}" for i, stage in enumerate(cost.stages, 1)]
    return lines


def _terms(terms: Mapping[str, tuple[float, Any]]) -> str:
    return ", ".join(f"`{term}` {weight:+.3g}" for term, (weight, _) in terms.items())


def weights(terms: Mapping[str, tuple[float, Any]]) -> str:
    """A table of a cost's terms, with what each term's own docstring says."""
    told = {name: summary(function) for name, (_, function) in terms.items()}
    shared = {text for text, count in Counter(told.values()).items() if count > 1}  # of what made several terms at once
    rows = [
        [f"`{name}`", f"{weight:+.3g}", "" if told[name] in shared else told[name]]
        for name, (weight, _) in terms.items()
    ]
    head = ["term", "weight", "what it is"]
    if not any(row[2] for row in rows):
        return grid(head[:2], [row[:2] for row in rows])
    return grid(head, rows)


def summary(function: Any) -> str:
    """First paragraph of a function's docstring, or of the function that made it; else nothing."""
    told = getattr(function, "__doc__", None) if hasattr(function, "__qualname__") else None
    if not told and ".<locals>" in getattr(function, "__qualname__", ""):
        maker = function.__qualname__.partition(".<locals>")[0]
        told = getattr(getattr(sys.modules[function.__module__], maker, None), "__doc__", None)
    return plain(" ".join((told or "").strip().split("\n\n")[0].split()))


def action_table(task: Task) -> str:
    """The action space and what its components mean."""
    rows = [[_components(channel), _CHANNELS[channel.kind], _unit(channel)] for channel in task.control.channels]
    return f"`{action_space(task.action_size)}`\n\n{grid(['components', 'meaning', 'unit of 1.0'], rows)}"


def _components(channel: Channel) -> str:
    last = channel.stop - 1
    return str(last) if last == channel.start else f"{channel.start} to {last}"


def _unit(channel: Channel) -> str:
    return f"{channel.unit:g} {_UNITS[channel.kind]}" if channel.kind in _UNITS else "-"


def observation_table(task: Task) -> str:
    """The observation space: key, shape, meaning."""
    space = observation_space(task.layout, task.goal_size)
    rows = [[f"`{key}`", f"`{box.shape}`", _MEANINGS[key]] for key, box in space.items()]
    return f"`Dict`, float32:\n\n{grid(['key', 'shape', 'meaning'], rows)}"


def starting_state(task: Task) -> str:
    """Where the scenes of the checkpoint's bank have their entities, or that there is none."""
    folder = default_checkpoints().get(task.name)
    if folder is None:
        return (
            "No checkpoint ships with scenes of this task: episodes start from a scene that "
            '`env.reset(options={"scene": scene})` is given, such as the twin\'s `scene()`.\n'
        )
    bank = _loaded(folder).banks[task.name]
    rows = [
        [f"`{entity.name}`", *(_range(bank.poses[:, i, axis]) for axis in range(3))]
        for i, entity in enumerate(bank.layout)
    ]
    if task.goal_size == 3:
        rows.append(["goal", *(_range(bank.goals[:, axis]) for axis in range(3))])
    told = f"One of {len(bank)} scenes of checkpoint `{folder.name}`, at rest. Where things stand in them, metres:\n"
    return f"{told}\n{grid(['', 'x', 'y', 'z'], rows)}"


def _range(values: np.ndarray) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low + 0.0:.3f}" if high - low < 0.0005 else f"{low:.3f} to {high:.3f}"
