"""Rollouts of a model over the truth, a strip of a few instants an episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from PIL import Image

from pwm_gym.data.dataset import Dataset
from pwm_gym.data.episodes import KINDS
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.errors import PwmGymError
from pwm_gym.evaluation.metrics import chamfer
from pwm_gym.evaluation.rollouts import OBSERVED, predict
from pwm_gym.viewer.overlays import draw_overlays
from pwm_gym.viewer.twin import TwinRecord

__all__ = ["draw_rollout_strips", "rollout_records"]


def draw_rollout_strips(model: WorldModel, dataset: Dataset, title: str, steps: int = 5) -> Image.Image:
    """The first episode of each kind: predicted clouds (teal) over true ones (purple) at ``steps`` instants.

    Args:
        model: world model on the CPU.
        dataset: episodes of one split.
        title: over all.
        steps: instants of each episode, from its first predicted step to its last.

    Raises:
        PwmGymError: no episode is long enough, or the model's prediction is not finite.
    """
    return draw_overlays(rollout_records(model, dataset, _first_of_each_kind(dataset)), title, steps=steps, across=1)


def _first_of_each_kind(dataset: Dataset) -> list[int]:
    """Place of the first episode of each kind that is long enough to be predicted."""
    found: dict[int, int] = {}
    for index, episode in enumerate(dataset.episodes):
        if len(episode) > OBSERVED:
            found.setdefault(episode.kind, index)
    if not found:
        raise PwmGymError("no episode is long enough to be drawn")
    return [found[kind] for kind in sorted(found)]


def rollout_records(model: WorldModel, dataset: Dataset, chosen: Sequence[int]) -> list[TwinRecord]:
    """Rollouts of chosen episodes and the truth, ready to be drawn."""
    episodes = tuple(dataset.episodes[i] for i in chosen)
    rollouts = predict(model, replace(dataset, episodes=episodes))
    layout = rollouts.states.layout
    records = []
    for m, (episode, length) in enumerate(zip(rollouts.episodes, rollouts.lengths, strict=True)):
        told = rollouts.states[m].points()[:length].numpy()
        true = rollouts.true_states(slice(m, m + 1)).coarsen(layout)[0].points()[:length].numpy()
        if not np.isfinite(told).all():
            raise PwmGymError(f"the prediction of episode {episode.seed} is not finite")
        error = np.array([chamfer(a, b) for a, b in zip(told, true, strict=True)])
        about = f"{KINDS[episode.kind]}, seed {episode.seed}: Chamfer L1 {1e3 * error[-1]:.1f} mm after {length} steps"
        records.append(TwinRecord(told, true, layout, error, _place(episode.goal), subtitle=about))
    return records


def _place(goal: np.ndarray) -> np.ndarray | None:
    """The goal where it is a place (3,)."""
    return goal if len(goal) == 3 else None
