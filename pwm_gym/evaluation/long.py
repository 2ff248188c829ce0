"""Long rollouts: hundreds of steps of expert and random actions in turn, in the simulator and in the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tqdm import tqdm

from pwm_gym.collection.recording import record_episode
from pwm_gym.data.dataset import Dataset
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.evaluation.metrics import chamfer
from pwm_gym.evaluation.rollouts import OBSERVED, position_errors, predict
from pwm_gym.seeds import seed_range
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

__all__ = ["LENGTHS", "error_curves", "mixed_episodes"]

LENGTHS = (66, 150, 300)
"""Rollout steps at which errors are reported."""
_SEGMENT = (15, 41)  # steps of a segment: from, below
_OFFSET = 90_000  # of the seeds within the test split's, which no data set takes
_QUARTILES = (25, 50, 75)


class _Mixed:
    """Segments of the expert's and of uniformly random actions in turn."""

    kind, switch = "practice", -1

    def __init__(self, task: Task, rng: np.random.Generator) -> None:
        self._task, self._rng = task, rng
        self._expert, self._left, self._wild = task.expert(rng), int(rng.integers(*_SEGMENT)), False

    def start(self, simulator: Simulator) -> None:
        pass

    def act(self, simulator: Simulator) -> np.ndarray:
        if self._left == 0:
            self._left, self._wild = int(self._rng.integers(*_SEGMENT)), not self._wild
        self._left -= 1
        if self._wild:
            return self._rng.uniform(-1.0, 1.0, self._task.action_size).astype(np.float32)
        return self._expert.act(simulator.poses(), simulator.goal(), simulator.assets())

    def done(self, success: bool) -> bool:
        return False


def mixed_episodes(
    simulator: Simulator, task: Task, dataset: Dataset, count: int = 20, steps: int = 300, progress: bool = True
) -> Dataset:
    """``count`` episodes of ``steps`` predicted steps, of test seeds that no data set takes.

    Args:
        simulator: of the task.
        task: the task.
        dataset: gives the objects' clouds.
        count: episodes.
        steps: steps after the observed ones.
        progress: whether to show a bar.
    """
    seeds = seed_range("test", count, _OFFSET)
    episodes = [
        record_episode(simulator, s, lambda s: _Mixed(task, np.random.default_rng([s, 7])), steps + OBSERVED - 1)
        for s in tqdm(seeds, disable=not progress, desc="long episodes", leave=False)
    ]
    return replace(dataset, episodes=tuple(episodes))


@dataclass(frozen=True)
class ErrorCurves:
    """Quartiles (3, H) of errors at each step of long rollouts."""

    steps: np.ndarray
    """Steps (K,) at which Chamfer distances were measured."""
    chamfer: np.ndarray
    """Chamfer L1 (3, K), metres."""
    positions: dict[str, np.ndarray]
    """Entity -> position errors (3, H), millimetres."""
    mean_chamfer: dict[int, float]
    """Length -> Chamfer L1 averaged over the steps up to it, metres."""

    def summary(self) -> dict[str, Any]:
        """Plain values for a file."""
        return {
            "chamfer_l1_mean_to_step": self.mean_chamfer,
            "quartiles": _QUARTILES,
            "steps": self.steps.tolist(),
            "chamfer_l1": self.chamfer.tolist(),
            "position_mm": {k: v[:, self.steps - 1].tolist() for k, v in self.positions.items()},
        }


def error_curves(model: WorldModel, dataset: Dataset, every: int = 10, progress: bool = True) -> ErrorCurves:
    """Errors of a model along long episodes.

    Args:
        model: world model on the CPU.
        dataset: of :func:`mixed_episodes`.
        every: Chamfer distances are measured at each ``every``-th step, and at the lengths that are reported.
        progress: whether to show a bar.
    """
    rollouts = predict(model, dataset)
    horizon = rollouts.poses.shape[1]
    reported = [n for n in LENGTHS if n <= horizon]
    steps = np.unique([*range(every, horizon + 1, every), *reported])
    truth = rollouts.true_states()
    distances = np.empty((len(rollouts.episodes), len(steps)))
    for m in tqdm(range(len(rollouts.episodes)), disable=not progress, desc="score", leave=False):
        predicted, true = (s[m, steps - 1].points().numpy() for s in (rollouts.states, truth))
        distances[m] = [chamfer(a, b) for a, b in zip(predicted, true, strict=True)]
    positions = {
        e.name: np.percentile(1e3 * position_errors(rollouts, i).numpy(), _QUARTILES, axis=0)
        for i, e in enumerate(dataset.layout)
        if not e.joint.moves
    }
    means = {n: float(distances[:, steps <= n].mean()) for n in reported}
    return ErrorCurves(steps, np.percentile(distances, _QUARTILES, axis=0), positions, means)
