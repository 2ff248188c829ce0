"""Planning success of models and planners, from one look an episode to a look at every step (paper, section 4.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch

from pwm_gym.completion import SHIPPED
from pwm_gym.data import load_split
from pwm_gym.data.partial import PartialView
from pwm_gym.data.simulated import check_objects
from pwm_gym.dynamics import WorldModel, load_checkpoint, resolve
from pwm_gym.errors import look_up
from pwm_gym.evaluation.planning import load_runs, planning_table, run_episodes, save_runs
from pwm_gym.experiments.pieces import Piece, run_pieces
from pwm_gym.experiments.tables import row_folder, trained
from pwm_gym.learning import digest
from pwm_gym.planning import Agent, Run, SamplingConfig, get_planner_config
from pwm_gym.scene import Scene
from pwm_gym.seeds import seed_range
from pwm_gym.sim import Simulator
from pwm_gym.sim.model import SimulatorModel
from pwm_gym.tasks import Task, get_task
from pwm_gym.training import fit_baseline

__all__ = ["CHUNKS", "PLANNING_TABLES", "Member", "PlanningTable", "run_planning_table"]

CHUNKS = {"closed loop": 1, "chunks of 20": 20, "chunks of 50": 50, "open loop": 0}
"""Name -> actions between two looks; 0 looks once."""

_EPISODES, _SLOW_EPISODES, _FULL_EPISODES = 20, 5, 100
_SLOW_SHARE = 0.5  # of the actions that an episode of the task may have


@dataclass(frozen=True)
class Member:
    """A model that is planned in, and the planner."""

    name: str
    kind: str
    """"checkpoint", "row" (of the table of rollouts), "baseline" (without learning) or "simulator"."""
    source: str
    """The checkpoint, the row or the baseline."""
    slow: bool = False
    """Whether it plans fewer and shorter episodes."""
    samples: int | None = None
    """Action sequences of a plan; None takes as many as the planner's settings say."""
    partial: bool = False
    """Whether it sees what one camera sees."""
    planner: str | None = None
    """Registered planner; None takes the task's."""
    observation: str = "complete"
    """What the environment shows: "complete" clouds, or ones "completed" from a camera's depth."""
    sensor: str = "ideal"
    """Sensor model of that camera."""
    episodes: int | None = None
    """Episodes that it plans; None takes the table's."""

    def config(self, task: Task) -> SamplingConfig:
        """Settings of its planner."""
        config = get_planner_config(self.planner or task.planner)
        return config if self.samples is None else config.resize(self.samples)

    def max_steps(self, task: Task) -> int:
        """Actions of an episode at most."""
        return max(1, round(task.max_episode_steps * (_SLOW_SHARE if self.slow else 1.0)))

    def count(self, full: bool) -> int:
        """Episodes that it plans; ``full`` takes more of them where it is fast."""
        if self.episodes is not None:
            return self.episodes
        return _SLOW_EPISODES if self.slow else _FULL_EPISODES if full else _EPISODES


@dataclass(frozen=True)
class PlanningTable:
    """Members with one caption, each in all modes."""

    caption: str
    members: tuple[Member, ...]
    modes: tuple[str, ...] = tuple(CHUNKS)

    def choose(self, names: Sequence[str] = ()) -> tuple[Member, ...]:
        """The members called ``names``, or all.

        Raises:
            UnknownNameError: listing the known ones.
        """
        known = {member.name: member for member in self.members}
        return tuple(look_up("member of the table", name, known) for name in names) if names else self.members


_POINTS: dict[str, Any] = {"kind": "row", "slow": True, "samples": 32}
_MODELS = (
    Member(name="compact (default)", kind="checkpoint", source="default"),
    Member(name="3DPWM, paper-small", source="3DPWM, paper-small", **_POINTS),
    Member(name="ParticleFormer+", source="ParticleFormer+", partial=True, **_POINTS),
    Member(name="Partial 3DPWM", source="Partial 3DPWM", partial=True, **_POINTS),
    Member(name="linear response, no learning", kind="baseline", source="linear"),
    Member(name="the simulator itself", kind="simulator", source="", slow=True),
)
_PROTOCOL: dict[str, Any] = {"planner": "mppi-paper", "episodes": 20}
_PAPER = (
    Member(name="compact (default)", kind="checkpoint", source="default", **_PROTOCOL),
    Member(name="3DPWM, paper-small", kind="row", source="3DPWM, paper-small", **_PROTOCOL),
    Member(name="ParticleFormer+", kind="row", source="ParticleFormer+", partial=True, **_PROTOCOL),
    Member(name="Partial 3DPWM", kind="row", source="Partial 3DPWM", partial=True, **_PROTOCOL),
    Member(name="linear response, no learning", kind="baseline", source="linear", **_PROTOCOL),
)
_DEFAULT: dict[str, Any] = {"kind": "checkpoint", "source": "default"}
_PLANNERS = {"MPPI": "mppi", "CEM": "cem", "iCEM": "icem", "gradient": "gradient"}

PLANNING_TABLES: dict[str, PlanningTable] = {
    "planning": PlanningTable("Planning success in the simulator (paper, section 4.2)", _MODELS),
    "planning-paper": PlanningTable(
        "Planning by the paper's own protocol: MPPI of 200 samples, horizon 10, sigma 5, 20 runs",
        _PAPER,
        modes=("closed loop", "open loop"),
    ),
    "planners": PlanningTable(
        "Planners, all in the default model",
        tuple(
            Member(name=name, kind="checkpoint", source="default", planner=planner)
            for name, planner in _PLANNERS.items()
        ),
        modes=("closed loop", "open loop"),
    ),
    "completed": PlanningTable(
        "Planning from what a camera sees, in the default model",
        (
            Member(name="complete clouds", **_DEFAULT),
            Member(name="completed from ideal depth", observation="completed", **_DEFAULT),
            Member(name="completed from a D455's depth", observation="completed", sensor="d455", **_DEFAULT),
        ),
        modes=("closed loop", "chunks of 20"),
    ),
}
"""Name -> table."""


def run_planning_table(
    table: PlanningTable,
    data: Path,
    out: Path,
    task: str = "PickCube",
    full: bool = False,
    members: Sequence[str] = (),
    draw: Callable[[str, str, Sequence[Run]], str] | None = None,
    objects: str = "",
    modes: Sequence[str] = (),
    scale: float = 1.0,
) -> dict[str, Any]:
    """Plan with every member in every mode; what is there already is kept, and progress is printed.

    Args:
        table: what to plan with.
        data: a data set, for the baseline's fit and for members that are not trained yet.
        out: folder of the pieces, as of :func:`pwm_gym.experiments.run_table`.
        task: registered task.
        full: whether the fast members plan 100 episodes instead of 20.
        members: names of rows; none given takes all.
        draw: draws the failed runs of a row in a mode, and returns the picture's name; None draws none.
        objects: what episodes draw their objects from, as of :meth:`pwm_gym.tasks.Task.make_simulator`; "" for the
            task's default.
        modes: names of modes; none given takes all.
        scale: share of the table's training steps that members take that are rows of the table of rollouts.

    Raises:
        UnknownNameError: the table has no such member or mode.
        PwmGymError: the task has no such objects.
    """
    chosen = table.choose(members)
    check_objects(get_task(task), objects)
    asked = [look_up("mode", mode, {m: m for m in table.modes}) for mode in modes or table.modes]
    pieces = {(m.name, mode): _piece(m, mode, data, out, task, full, objects, scale) for m in chosen for mode in asked}
    results = dict(zip(pieces, run_pieces(list(pieces.values())), strict=True))
    for (name, mode), result in results.items():
        if draw is not None and result["failed_seeds"]:
            failed = load_runs(result["failed_seeds"], pieces[name, mode].folder)
            result["picture"] = draw(name, mode, failed)
    rows = [_row(member, get_task(task), {mode: results[member.name, mode] for mode in asked}) for member in chosen]
    return {"caption": table.caption, "rows": rows}


def _row(member: Member, task: Task, modes: dict[str, Any]) -> dict[str, Any]:
    config = member.config(task)
    return {
        "row": member.name,
        "partial": member.partial,
        "planner": member.planner or task.planner,
        "samples": config.samples,
        "iterations": config.iterations,
        "max_steps": member.max_steps(task),
        "horizon": config.horizon,
        "modes": modes,
    }


def _piece(
    member: Member, mode: str, data: Path, out: Path, task: str, full: bool, objects: str = "", scale: float = 1.0
) -> Piece:
    """One member in one mode, named after all that decides its result, so that tables share equal ones."""
    planned = get_task(task)
    config, most = member.config(planned), member.max_steps(planned)
    chunk = CHUNKS[mode] if CHUNKS[mode] < most else 0  # never looks again
    episodes = member.count(full)
    source = str(data)
    if member.kind == "checkpoint":
        source = digest(resolve(member.source, task))
    elif member.kind == "row":
        source = row_folder("rollout", member.source, data, out, task, scale).name
    if member.observation == "completed":
        source += digest(SHIPPED)
    asked = [objects] if objects else []
    recipe = (task, replace(member, name=""), source, chunk, episodes, config, most, *asked)
    make = partial(_planned, member, data, out, task, chunk, episodes, objects, scale)
    return Piece(f"{member.name}, {mode}", "planning", repr(recipe), out, make)


def _planned(
    member: Member,
    data: Path,
    out: Path,
    task: str,
    chunk: int,
    episodes: int,
    objects: str,
    scale: float,
    folder: Path,
) -> dict[str, Any]:
    """Plan with one member in one mode."""
    model = _model(member, data, out, get_task(task).name, objects, scale)
    table = _plan(model, member, get_task(task), chunk, episodes, objects, folder)
    return {"threads": torch.get_num_threads(), **table}


@lru_cache(maxsize=1)  # the modes of a member follow each other
def _model(member: Member, data: Path, out: Path, task_name: str, objects: str, scale: float) -> WorldModel:
    """The member's model, trained where it is not yet."""
    task = get_task(task_name)
    if member.kind == "checkpoint":
        return load_checkpoint(resolve(member.source, task.name)).model
    if member.kind == "row":
        threads = torch.get_num_threads()
        folder = trained("rollout", member.source, data, out, task.name, scale)
        torch.set_num_threads(threads)  # a training sets its own
        return load_checkpoint(folder).model
    if member.kind == "simulator":
        return SimulatorModel(task.make_simulator(objects or None), task.layout, task.name, task.goal_size)
    return fit_baseline(member.source, load_split(data, "train", task.name))


def _plan(
    model: WorldModel, member: Member, task: Task, chunk: int, episodes: int, objects: str, folder: Path
) -> dict[str, Any]:
    """Test seeds of planning in the simulator; failed runs are saved in ``folder``."""
    from pwm_gym.envs import CameraConfig  # trainings import this module, and need no environments

    agent, seeds = Agent(model, task.name, member.config(task)), seed_range("plan_test", episodes)
    most = member.max_steps(task)
    shown: dict[str, Any] = {"observation": member.observation, "camera": CameraConfig(sensor=member.sensor)}
    twin = f"pwm/{task.name}Sim-v0"
    with gym.make(twin, max_episode_steps=most, objects=objects or None, **shown) as env:
        observe = _partial_views(env, task) if member.partial else None
        runs = run_episodes(env, agent, seeds, most, chunk, observe)
    save_runs([run for run in runs if not run.success], folder)
    return planning_table(runs)


def _partial_views(twin: gym.Env[Any, Any], task: Task) -> Callable[[Scene], Scene]:
    """What a camera sees of a twin's present scene."""
    simulator: Simulator = twin.unwrapped.simulator  # type: ignore[attr-defined]
    views: dict[tuple[str, ...], PartialView] = {}

    def observe(scene: Scene) -> Scene:
        if scene.assets not in views:
            views[scene.assets] = PartialView(simulator.meshes(), task.layout)
        return views[scene.assets](scene)

    return observe
