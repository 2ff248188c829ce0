"""The rollout table: every metric of a world model on a test split, beside baselines, oracle and floors."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from pwm_gym.costs import cost_info, get_cost, get_grasp
from pwm_gym.data.dataset import Dataset
from pwm_gym.data.episodes import KINDS
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.evaluation.calibration import calibration
from pwm_gym.evaluation.metrics import chamfer, pearson
from pwm_gym.evaluation.onsets import onset_errors
from pwm_gym.evaluation.rollouts import (
    OBSERVED,
    STEPS,
    Rollouts,
    at_steps,
    joint_errors,
    position_errors,
    predict,
    rotation_errors,
)
from pwm_gym.scene import RigidState, State
from pwm_gym.tasks import Task

__all__ = ["SPLITS", "STEPS", "evaluate_rollouts", "onsets_by_split"]

SPLITS: dict[str, tuple[str, ...]] = {
    "all": ("expert", "randomised"),
    "expert": ("expert",),
    "randomised": ("randomised",),
    "practice": ("practice",),
}
"""Row of the table -> kinds of episodes; "all" is the paper's mix."""
_CHUNK = 8  # episodes whose points are formed at once


@dataclass(frozen=True)
class _Scores:
    """Per episode (M,) and per step (M, H); NaN where there is none."""

    chamfer: np.ndarray
    euclidean: np.ndarray
    entity_mean: np.ndarray
    correlation: np.ndarray
    ceiling: np.ndarray


def evaluate_rollouts(
    model: WorldModel,
    task: Task,
    dataset: Dataset,
    oracle: bool = False,
    every: int = 1,
    progress: bool = True,
    start: RigidState | None = None,
) -> dict[str, Any]:
    """Metrics of ``model`` for each of :data:`SPLITS` that ``dataset`` has.

    Args:
        model: world model on the CPU.
        task: gives the reward and the names.
        dataset: test split.
        oracle: whether the true end effector replaces the predicted one after each step.
        every: Chamfer distances are measured at each ``every``-th step.
        progress: whether to show a bar.
        start: what is observed of each episode's first steps, as of :func:`predict`; it is scored against the complete
            truth.
    """
    rollouts = predict(model, dataset, oracle_effector=oracle, start=start)
    scores = _score(rollouts, task, every, progress)
    kinds = np.array([KINDS[e.kind] for e in rollouts.episodes])
    table = {}
    for split, wanted in SPLITS.items():
        chosen = np.isin(kinds, wanted)
        if chosen.any():
            table[split] = _summary(rollouts, scores, chosen)
    return table


def onsets_by_split(model: WorldModel, dataset: Dataset) -> dict[str, Any]:
    """Onset errors (:func:`~pwm_gym.evaluation.onsets.onset_errors`) of each of :data:`SPLITS` that has onsets."""
    table = {}
    for split, kinds in SPLITS.items():
        if (told := onset_errors(model, dataset.of_kinds(kinds))) is not None:
            table[split] = told
    return table


def _score(rollouts: Rollouts, task: Task, every: int, progress: bool) -> _Scores:
    count, horizon = rollouts.poses.shape[:2]
    distances = np.full((3, count, horizon), np.nan)
    correlations = np.full((2, count), np.nan)
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        for k in tqdm(range(0, count, _CHUNK), disable=not progress, desc="score", leave=False):
            part = slice(k, k + _CHUNK)
            truth = rollouts.true_states(part)
            predicted = rollouts.states[part]
            places = [(m, h) for m, n in enumerate(rollouts.lengths[part]) for h in range(every - 1, n, every)]
            _fill_distances(distances[:, part], predicted, truth, places, pool.map)
            correlations[:, part] = _correlations(rollouts, part, predicted, truth, task)
    return _Scores(*distances, *correlations)


def _fill_distances(
    out: np.ndarray, predicted: State, truth: State, places: list[tuple[int, int]], each: Callable[..., Any]
) -> None:
    """Chamfer L1, Euclidean and entity-mean L1 at ``places``, into ``out`` (3, M, H)."""
    a, b = predicted.points().numpy(), truth.points().numpy()
    slices = [(e.slice, f.slice) for e, f in zip(predicted.layout, truth.layout, strict=True)]

    def one(index: tuple[int, int]) -> tuple[float, float, float]:
        p, q = a[index], b[index]
        if not np.isfinite(p).all():
            return np.inf, np.inf, np.inf
        parts = [chamfer(p[s], q[t]) for s, t in slices]
        return chamfer(p, q), chamfer(p, q, order=2), float(np.mean(parts))

    for (m, h), values in zip(places, each(one, places), strict=True):
        out[:, m, h] = values


def _correlations(
    rollouts: Rollouts, part: slice, predicted: State, truth: State, task: Task
) -> tuple[np.ndarray, np.ndarray]:
    """Reward correlation of each episode on predicted clouds, and its ceiling on true ones."""
    episodes, lengths = rollouts.episodes[part], rollouts.lengths[part]
    goals = torch.as_tensor(np.stack([e.goal for e in episodes]))
    series = [_rewards(s, rollouts.actions[part], goals, task).numpy() for s in (predicted, truth)]
    rows = []
    for values in series:
        row = []
        for m, (episode, length) in enumerate(zip(episodes, lengths, strict=True)):
            r = pearson(values[m, :length], episode.rewards[OBSERVED - 1 :])
            row.append(np.nan if r is None else r)
        rows.append(np.array(row))
    return rows[0], rows[1]


def _rewards(states: State, actions: Tensor, goals: Tensor, task: Task) -> Tensor:
    """The task's reward (M, H) on clouds of states (M, H)."""
    flat = states.map(lambda x: torch.nan_to_num(x).flatten(0, 1))
    count, horizon, size = actions.shape
    goal = goals.unsqueeze(1).expand(-1, horizon, -1).flatten(0, 1)
    points, info = cost_info(flat, actions.reshape(-1, size), goal, get_grasp(task.grasp))
    return -get_cost(task.cost)(points, info).view(count, horizon)


def _summary(rollouts: Rollouts, scores: _Scores, chosen: np.ndarray) -> dict[str, Any]:
    """Averages over the chosen episodes."""

    def trajectory_mean(values: np.ndarray) -> float:
        return float(np.nanmean(values[chosen], 1).mean())

    out: dict[str, Any] = {
        "episodes": int(chosen.sum()),
        "mean_steps": float(rollouts.lengths[chosen].mean()),
        "chamfer_l1": trajectory_mean(scores.chamfer),
        "chamfer_l2": trajectory_mean(scores.euclidean),
        "chamfer_l1_entity_mean": trajectory_mean(scores.entity_mean),
        "reward_correlation": _finite_mean(scores.correlation[chosen]),
        "reward_correlation_ceiling": _finite_mean(scores.ceiling[chosen]),
        "reward_without_variance": int(np.isnan(scores.correlation[chosen]).sum()),
        "chamfer_l1_by_step": _by_step(scores.chamfer[chosen]),
        "entities": {},
    }
    if (told := calibration(rollouts, chosen)) is not None:
        out["calibration"] = told
    for i, entity in enumerate(rollouts.dataset.layout):
        errors = {"position_mm": 1e3 * position_errors(rollouts, i), "rotation_deg": rotation_errors(rollouts, i)}
        if entity.articulated:
            unit = "deg" if entity.joint.kind == "revolute" else "mm"
            errors[f"joint_{unit}"] = joint_errors(rollouts, i)
        lengths = rollouts.lengths[chosen]
        out["entities"][entity.name] = {k: at_steps(v.numpy()[chosen], lengths) for k, v in errors.items()}
    return out


def _finite_mean(values: np.ndarray) -> float | None:
    """Mean of what is not NaN; None where nothing is left."""
    kept = values[~np.isnan(values)]
    return float(kept.mean()) if len(kept) else None


def _by_step(values: np.ndarray) -> dict[str, float]:
    """Mean of the measured steps (M, H), numbered from 1, as far as half of the episodes reach."""
    measured = np.isfinite(values).sum(0)
    return {str(h + 1): float(np.nanmean(values[:, h])) for h in np.flatnonzero(measured >= 0.5 * len(values))}
