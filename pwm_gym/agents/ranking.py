"""Policies compared in the world model and in its simulator twin, from the same scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor

from pwm_gym.agents.contestants import Begins, contestant, training_of
from pwm_gym.dynamics import resolve
from pwm_gym.envs import ModelVectorEnv
from pwm_gym.errors import PwmGymError, check_whole
from pwm_gym.evaluation.ranking import ranking_table
from pwm_gym.experiments.pieces import Piece, run_pieces
from pwm_gym.learning import digest
from pwm_gym.policies import ActsOnPoses
from pwm_gym.process import prepare_process
from pwm_gym.scene import RigidState, Scene, batch_state
from pwm_gym.seeds import seed_range
from pwm_gym.tasks import Task, get_task
from pwm_gym.workers import Workers

__all__ = ["rank_contestants", "rank_policies", "succeeds_in_model", "succeeds_in_twin"]

_BATCH = 128  # scenes at once in the model


def rank_policies(
    policies: Mapping[str, ActsOnPoses],
    task: str,
    scenes: int = 200,
    checkpoint: str = "default",
    max_steps: int | None = None,
) -> dict[str, Any]:
    """Rank policies of one's own in the model and in the simulator, from the same scenes.

    Args:
        policies: name -> policy: ``act(state, goal)`` gives actions (B, A) for a :class:`pwm_gym.scene.RigidState` (B,)
            and goals (B, G). One with randomness has ``begin(episodes)``, too.
        task: registered task.
        scenes: how many, of the simulator's planning test seeds; those solved at reset are left out.
        checkpoint: the world model's folder or shipped name.
        max_steps: of an episode; None takes the task's limit.

    Returns:
        As of :func:`pwm_gym.evaluation.ranking_table`, with ``success``, the paired matrix: name -> "model" and
        "simulator" -> a digit for each scene, 1 for success.

    Raises:
        PwmGymError: fewer than two policies, one that has no ``act``, actions of a wrong shape, or a number of scenes
            that cannot be.
    """
    check_whole("scenes", scenes, 1)
    if len(policies) < 2:
        raise PwmGymError(f"policies {', '.join(map(repr, policies)) or 'none'}; expected at least two")
    for name, policy in policies.items():
        if not callable(getattr(policy, "act", None)):
            raise PwmGymError(f"policy {name!r} is a {type(policy).__name__}; expected something with act(state, goal)")
    told, real = [], []
    for policy in policies.values():
        started, won = succeeds_in_twin(policy, task, seed_range("plan_test", scenes), max_steps)
        real.append(won)
        told.append(succeeds_in_model(policy, task, started, checkpoint, max_steps))
    table = ranking_table([*policies], np.stack(told), np.stack(real))
    return {**table, "success": _paired([*policies], told, real)}


def _paired(names: Sequence[str], told: Iterable[Any], real: Iterable[Any]) -> dict[str, dict[str, str]]:
    """Each policy's success in both worlds, a digit a scene."""
    rows = zip(names, told, real, strict=True)
    return {name: {"model": _digits(one), "simulator": _digits(other)} for name, one, other in rows}


def _digits(won: Any) -> str:
    return "".join("1" if each else "0" for each in won)


def rank_contestants(
    specs: Sequence[str],
    task: str,
    out: Path,
    scenes: int = 200,
    checkpoint: str = "default",
    max_steps: int | None = None,
    floor: bool = True,
    workers: int | Workers = 1,
    tell: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Rank policies by name; what a killed run has finished is kept.

    Args:
        specs: as of :func:`pwm_gym.agents.contestants.contestant`.
        task: registered task.
        out: folder of the pieces.
        scenes: how many.
        checkpoint: the world model's folder or shipped name.
        max_steps: of an episode; None takes the task's limit.
        floor: whether to rank the twin against itself on as many other scenes, too: what no model can be better than.
        workers: policies at once, or who runs them.
        tell: is given a line a finished policy.

    Returns:
        As of :func:`pwm_gym.evaluation.ranking_table`, the floor as another such table, what each agent's training
        took until it was saved, and ``success``, as of :func:`rank_policies`.

    Raises:
        PwmGymError: fewer than two policies, one named twice, or one that is none.
    """
    if len({*specs}) != len(specs) or len(specs) < 2:
        raise PwmGymError(f"policies {', '.join(specs) or 'none'}; expected at least two different ones")
    known = get_task(task)
    for spec in specs:
        contestant(spec, known)  # a wrong one ends all before anything is run
    model = digest(resolve(checkpoint, task))
    pieces = [
        Piece(
            spec,
            "ranked",
            f"{task}, {_told(spec, task)}, {model}, scenes={scenes}, max_steps={max_steps}, floor={floor}",
            out,
            partial(_rank_one, spec, task, scenes, checkpoint, max_steps, floor),
        )
        for spec in specs
    ]
    rows = run_pieces(pieces, workers, tell)
    told, real = (np.array([row[key] for row in rows], bool) for key in ("model", "simulator"))
    table = ranking_table(specs, told, real)
    for row, spec in zip(table["rows"], specs, strict=True):
        if (took := training_of(spec)) is not None:
            row["training"] = took
    if floor:
        again = np.array([row["others"] for row in rows], bool)
        count = min(again.shape[1], real.shape[1])
        table["floor"] = ranking_table(specs, again[:, :count], real[:, :count])
    return {"task": task, **table, "success": _paired(specs, told, real)}


def _told(spec: str, task: str) -> str:
    """What decides a policy: its weights, or its name and the model that it plans in."""
    if Path(spec).is_dir():
        return digest(Path(spec))
    kind, _, model = spec.partition("@")
    return f"{kind}, {digest(resolve(model, task))}" if model else spec


def _rank_one(
    spec: str, task: str, scenes: int, checkpoint: str, max_steps: int | None, floor: bool, folder: Path
) -> dict[str, Any]:
    """Success of one policy in both worlds, scene by scene."""
    prepare_process(1)
    policy = contestant(spec, get_task(task))
    started, won = succeeds_in_twin(policy, task, seed_range("plan_test", scenes), max_steps)
    told = succeeds_in_model(policy, task, started, checkpoint, max_steps)
    result = {"model": told.tolist(), "simulator": won.tolist()}
    if floor:
        _, others = succeeds_in_twin(policy, task, seed_range("plan_test", scenes, scenes), max_steps)
        result["others"] = others.tolist()
    return result


@torch.no_grad()
def succeeds_in_twin(
    policy: ActsOnPoses, task: str, seeds: Sequence[int], max_steps: int | None = None
) -> tuple[list[Scene], np.ndarray]:
    """First scenes of the seeds' episodes, and whether the policy succeeds in them (N,) bool.

    Those that are solved at reset are left out of both.
    """
    most, scenes, won = max_steps or get_task(task).max_episode_steps, [], []
    with gym.make(f"pwm/{task}Sim-v0", max_episode_steps=most) as env:
        base: Any = env.unwrapped
        for number, seed in enumerate(seeds):
            _, info = env.reset(seed=seed)
            if info["success"]:
                continue
            scene = base.scene()
            scenes.append(scene)
            _begin(policy, [number])
            for _ in range(most):
                state = batch_state([scene])
                assert isinstance(state, RigidState)
                action = _act(policy, state, torch.as_tensor(scene.goal)[None], base.task)[0]
                _, _, terminated, truncated, info = env.step(action.cpu().numpy())
                if terminated or truncated:
                    break
                scene = base.scene()
            won.append(bool(info["success"]))
    return scenes, np.array(won, bool)


@torch.no_grad()
def succeeds_in_model(
    policy: ActsOnPoses, task: str, scenes: Sequence[Scene], checkpoint: str = "default", max_steps: int | None = None
) -> np.ndarray:
    """Whether a policy succeeds (N,) bool in the world model from scenes."""
    known, won = get_task(task), np.zeros(len(scenes), bool)
    for first in range(0, len(scenes), _BATCH):
        part = [*scenes[first : first + _BATCH]]
        batch = ModelVectorEnv(task, len(part), checkpoint, autoreset_mode="Disabled", observation="poses")
        batch.reset(options={"scene": part})
        _begin(policy, range(first, first + len(part)))
        ended = np.zeros(len(part), bool)
        for _ in range(max_steps or known.max_episode_steps):
            state = batch.state
            assert isinstance(state, RigidState)
            _, _, terminated, truncated, _ = batch.step(_act(policy, state, batch.goal, known))
            won[first : first + len(part)] |= terminated & ~ended
            ended |= terminated | truncated
            batch.resume()
            if ended.all():
                break
    return won


def _act(policy: ActsOnPoses, state: RigidState, goal: Tensor, task: Task) -> Tensor:
    """A policy's actions (B, A), which may be arrays."""
    action = torch.as_tensor(policy.act(state, goal))
    if action.shape != (len(goal), task.action_size):
        raise PwmGymError(f"actions of shape {tuple(action.shape)}; expected {(len(goal), task.action_size)}")
    return action


def _begin(policy: ActsOnPoses, episodes: Sequence[int]) -> None:
    if isinstance(policy, Begins):
        policy.begin(episodes)
