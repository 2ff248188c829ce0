"""Recorded episodes and the shards that hold them: poses per step, never points (paper, appendix "Data Generation")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from pwm_gym.errors import DatasetError
from pwm_gym.files import check_finite, load_arrays, save_arrays
from pwm_gym.scene import SCHEMA

__all__ = ["DEMONSTRATIONS", "FORMAT", "KINDS", "Episode", "read_shard", "write_shard"]

KINDS = ("expert", "randomised", "practice", "on_policy")
"""Kinds of episodes: the expert's, the expert's up to a random switch, mixed segments, and a planner's."""
DEMONSTRATIONS = KINDS[:2]
"""Those that the expert begins."""

_PER_EPISODE = ("goal", "kind", "seed", "switch")
_DIMENSIONS = {
    "poses": 3,
    "joints": 3,
    "actions": 2,
    "rewards": 1,
    "success": 1,
    "grasped": 1,
    "goal": 2,
    "kind": 1,
    "seed": 1,
    "switch": 1,
}
"""Number of dimensions of each array of a shard."""


FORMAT = "pwm_gym.episodes"


@dataclass(frozen=True)
class _Header:
    """What a shard says beside its arrays."""

    format: str
    schema: int
    task: str
    assets: list[tuple[str, ...]] = field(default_factory=list)


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
    assets: tuple[str, ...] = ()
    """Name of each entity's asset (E,), where a task's objects differ between episodes."""

    def __len__(self) -> int:
        return len(self.actions)

    @property
    def demonstrated(self) -> int:
        """Steps of a demonstration that the expert took."""
        return len(self) if self.switch < 0 else self.switch


def write_shard(path: Path, episodes: Sequence[Episode], header: dict[str, object]) -> None:
    """Write episodes to one ``.npz``: per-step arrays joined end to end, per-episode values stacked."""
    arrays: dict[str, np.ndarray] = {}
    for part in fields(Episode):
        if part.name == "assets":
            continue
        values = [getattr(e, part.name) for e in episodes]
        arrays[part.name] = np.stack(values) if part.name in _PER_EPISODE else np.concatenate(values)
    arrays["lengths"] = np.array([len(e) for e in episodes])
    for name, array in arrays.items():
        check_finite(array, f"{path}: {name}", DatasetError)
    save_arrays(path, arrays, {**header, "assets": [e.assets for e in episodes]})


def read_shard(path: Path, task: str | None = None) -> list[Episode]:
    """Episodes of one shard.

    Raises:
        DatasetError: the file is truncated, foreign, or of another task than ``task``.
    """
    complaint = "is truncated or not a shard; collect again to replace it"
    arrays, header = load_arrays(path, complaint, DatasetError, FORMAT, _Header)
    if task is not None and header.task != task:
        raise DatasetError(f"{path} holds episodes of {header.task!r}; expected {task!r}")
    if header.schema > SCHEMA:
        raise DatasetError(f"{path} has schema {header.schema}; this version reads up to {SCHEMA}")
    _check(path, arrays, header)
    return _split(arrays, header.assets)


def _check(path: Path, arrays: dict[str, np.ndarray], header: _Header) -> None:
    """Raise :class:`DatasetError` where a shard's arrays do not fit each other."""
    stored = [f.name for f in fields(Episode) if f.name != "assets"]
    if missing := [name for name in ("lengths", *stored) if name not in arrays]:
        raise DatasetError(f"{path} lacks {', '.join(missing)}; collect again to replace it")
    lengths = arrays["lengths"]
    if lengths.ndim != 1 or not np.issubdtype(lengths.dtype, np.integer) or (lengths < 1).any():
        raise DatasetError(f"{path} has lengths {lengths}; expected positive integers")
    steps, count = int(lengths.sum()), len(lengths)
    expected = {name: count if name in _PER_EPISODE else steps for name in stored}
    expected |= {"poses": steps + count, "joints": steps + count}
    for name, number in expected.items():
        if arrays[name].shape[:1] != (number,):
            raise DatasetError(f"{path}: {name} has shape {arrays[name].shape}; expected {number} rows")
        if arrays[name].ndim != _DIMENSIONS[name] or arrays[name].dtype.kind not in "fiub":
            found = f"shape {arrays[name].shape} and type {arrays[name].dtype}"
            raise DatasetError(f"{path}: {name} has {found}; expected {_DIMENSIONS[name]} dimensions of numbers")
    if arrays["poses"].shape[2] != 7:
        raise DatasetError(f"{path}: poses have shape {arrays['poses'].shape}; expected (frames, entities, 7)")
    if len(header.assets) not in (0, count):
        raise DatasetError(f"{path} names assets of {len(header.assets)} episodes; expected {count}")


def _split(arrays: dict[str, np.ndarray], assets: list[tuple[str, ...]]) -> list[Episode]:
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
                assets=assets[i] if assets else (),
            )
        )
        step, frame = step + length, frame + length + 1
    return episodes
