"""A collected data set in memory, and the windows that training draws from it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pwm_gym.data.episodes import KINDS, Episode, read_shard
from pwm_gym.errors import DatasetError, unknown_name
from pwm_gym.scene import Layout, Scene

__all__ = ["SPLITS", "Dataset", "load_split", "read_header"]

SPLITS = ("train", "validation", "test")
_SCHEMA = 1


@dataclass(frozen=True)
class Dataset:
    """Episodes of one split and the canonical clouds that they share."""

    task: str
    layout: Layout
    clouds: np.ndarray
    """(N, 3) float32."""
    episodes: tuple[Episode, ...]

    def of_kinds(self, kinds: Sequence[str]) -> Dataset:
        """Only the episodes of these kinds."""
        for kind in kinds:
            if kind not in KINDS:
                raise unknown_name("kind of episode", kind, KINDS)
        chosen = {KINDS.index(kind) for kind in kinds}
        kept = tuple(e for e in self.episodes if e.kind in chosen)
        return Dataset(self.task, self.layout, self.clouds, kept)

    def scene(self, episode: Episode, step: int = 0) -> Scene:
        """The scene at ``step`` of ``episode``, velocities included."""
        frames = [max(step - k, 0) for k in range(3)]
        return Scene(
            task=self.task,
            layout=self.layout,
            clouds=self.clouds,
            poses=episode.poses[frames].astype(np.float64),
            goal=episode.goal,
            joints=episode.joints[step],
            last_action=episode.actions[step - 1] if step else None,
        )


def read_header(folder: Path, task: str | None = None) -> dict[str, object]:
    """The data set's description.

    Raises:
        DatasetError: no data set is there, or one of another task or a newer schema.
    """
    path = Path(folder) / "dataset.json"
    if not path.exists():
        raise DatasetError(f"{folder} is not a data set: it has no dataset.json")
    try:
        header = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise DatasetError(f"{path} is truncated or not JSON ({error})") from error
    if header.get("format") != "pwm_gym.dataset":
        raise DatasetError(f"{path} has format {header.get('format')!r}; expected 'pwm_gym.dataset'")
    if header["schema"] > _SCHEMA:
        raise DatasetError(f"{path} has schema {header['schema']}; this version reads up to {_SCHEMA}")
    found = header["settings"]["task"]
    if task is not None and found != task:
        raise DatasetError(f"{folder} is a data set of task {found!r}; expected {task!r}")
    return header


def load_split(folder: Path | str, split: str, task: str | None = None) -> Dataset:
    """Every episode of ``split`` ("train", "validation" or "test") below ``folder``."""
    if split not in SPLITS:
        raise unknown_name("split", split, SPLITS)
    header = read_header(Path(folder), task)
    name = header["settings"]["task"]  # type: ignore[index]
    paths = sorted(Path(folder).glob(f"{split}-*.npz"))
    if not paths:
        raise DatasetError(f"{folder} has no episodes of split {split!r} yet")
    episodes = [episode for path in paths for episode in read_shard(path, name)]
    layout = Layout.from_json(header["layout"])  # type: ignore[arg-type]
    return Dataset(name, layout, np.asarray(header["clouds"], np.float32), tuple(episodes))
