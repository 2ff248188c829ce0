"""Scenes of recorded episodes as a checkpoint's bank."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pwm_gym.data.dataset import Dataset
from pwm_gym.dynamics import SceneBank

__all__ = ["bank_of", "underway_bank"]


def bank_of(dataset: Dataset, episodes: Sequence[int], steps: Sequence[int]) -> SceneBank:
    """The bank of scenes of a data set.

    Args:
        dataset: one split.
        episodes: place of each scene's episode.
        steps: step of each scene in its episode.
    """
    chosen = [dataset.episodes[k] for k in episodes]
    combinations = np.asarray(dataset.combination_of)[list(episodes)]
    used = sorted({int(k) for k in combinations})
    named = any(e.assets for e in chosen)
    return SceneBank(
        dataset.task,
        dataset.layout,
        dataset.clouds[used],
        np.stack([e.poses[step] for e, step in zip(chosen, steps, strict=True)]),
        np.stack([e.goal for e in chosen]),
        np.array([used.index(int(k)) for k in combinations]),
        tuple(dataset.combinations[k] for k in used) if named else (),
        np.stack([e.joints[step, 0] for e, step in zip(chosen, steps, strict=True)]),
    )


def underway_bank(dataset: Dataset, count: int, share: float, seed: int = 0) -> SceneBank:
    """Scenes of episodes drawn at random, a share of which are somewhere before the episode's first success.

    Half of these are in the last quarter of the way there, a third in its last tenth.

    Args:
        dataset: demonstrations.
        count: scenes.
        share: how many of them do not begin where their episode does.
        seed: of the draws.
    """
    rng = np.random.default_rng(seed)
    places = rng.integers(len(dataset.episodes), size=count)
    lengths = np.array([_before_success(dataset, int(k)) for k in places])
    drawn = np.floor(lengths * (1.0 - rng.random(count) ** 2)).astype(int).clip(max=lengths - 1)
    return bank_of(dataset, places.tolist(), np.where(rng.random(count) < share, drawn, 0).tolist())


def _before_success(dataset: Dataset, place: int) -> int:
    """Number of an episode's scenes that come before its first success, and before it turns random."""
    episode = dataset.episodes[place]
    return int(min([max(episode.demonstrated, 1), *np.flatnonzero(episode.success)[:1] + 1]))
