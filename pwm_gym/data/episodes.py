"""Recorded episodes and the shards that hold them: poses per step, never points (paper, appendix "Data Generation")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from pwm_gym.errors import DatasetError
from pwm_gym.files import load_arrays, save_arrays

__all__ = ["KINDS", "Episode", "read_shard", "write_shard"]

KINDS = ("expert", "randomised", "practice", "on_policy")
"""Kinds of episodes: the expert's, the expert's up to a random switch, mixed segments, and a planner's."""

_PER_EPISODE = ("goal", "kind", "seed", "switch")


@dataclass(frozen=True)
class Episode:
    """One episode of T steps in the simulator, in the robot base's frame."""

    poses: np.ndarray
    """(T + 1, E, 7) float32: xyz metres, quaternion wxyz."""
    joints: np.ndarray
    """(T + 1, 2, J) float32: positions and velocities, radians (metres) and these a step."""
    actions: np.ndarray
    """(T, A) float32."""
    rewards: np.ndarray
    """(T,) float32: the simulator's own, after each action."""
    success: np.ndarray
    """(T,) bool."""
    grasped: np.ndarray
    """(T,) bool: the simulator's contacts."""
    goal: np.ndarray
    """(G,) float32."""
    kind: int
    """Index into :data:`KINDS`."""
    seed: int
    switch: int = -1
    """Step of the switch to random actions; -1 where there is none."""

    def __len__(self) -> int:
        return len(self.actions)


def write_shard(path: Path, episodes: Sequence[Episode], header: dict[str, object]) -> None:
    """Write episodes to one ``.npz``: per-step arrays joined end to end, per-episode values stacked."""
    arrays: dict[str, np.ndarray] = {}
    for field in fields(Episode):
        values = [getattr(e, field.name) for e in episodes]
        arrays[field.name] = np.stack(values) if field.name in _PER_EPISODE else np.concatenate(values)
    arrays["lengths"] = np.array([len(e) for e in episodes])
    save_arrays(path, arrays, header)


def read_shard(path: Path, task: str | None = None) -> list[Episode]:
    """Episodes of one shard.

    Raises:
        DatasetError: the file is truncated, foreign, or of another task than ``task``.
    """
    complaint = "is truncated or not a shard; collect again to replace it"
    arrays, header = load_arrays(path, complaint, DatasetError, "pwm_gym.episodes")
    if task is not None and header["task"] != task:
        raise DatasetError(f"{path} holds episodes of {header['task']!r}; expected {task!r}")
    return _split(arrays)


def _split(arrays: dict[str, np.ndarray]) -> list[Episode]:
    lengths = arrays.pop("lengths")
    episodes, step, frame = [], 0, 0
    for i, length in enumerate(lengths):
        steps, frames = slice(step, step + length), slice(frame, frame + length + 1)
        episodes.append(
            Episode(
                poses=arrays["poses"][frames],
                joints=arrays["joints"][frames],
                actions=arrays["actions"][steps],
                rewards=arrays["rewards"][steps],
                success=arrays["success"][steps],
                grasped=arrays["grasped"][steps],
                goal=arrays["goal"][i],
                kind=int(arrays["kind"][i]),
                seed=int(arrays["seed"][i]),
                switch=int(arrays["switch"][i]),
            )
        )
        step, frame = step + length, frame + length + 1
    return episodes
