"""A collected data set in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pwm_gym.data.episodes import DEMONSTRATIONS, KINDS, Episode, read_shard
from pwm_gym.errors import DatasetError, unknown_name
from pwm_gym.files import load_arrays, save_arrays
from pwm_gym.scene import SCHEMA, Layout, Scene
from pwm_gym.schema import read_json

__all__ = [
    "ASSET",
    "FORMAT",
    "SPLITS",
    "Dataset",
    "Header",
    "asset_path",
    "load_demonstrations",
    "load_split",
    "load_splits",
    "read_header",
    "save_asset",
]

SPLITS = ("train", "validation", "test")
FORMAT = "pwm_gym.dataset"
ASSET = "asset-"
"""What names of assets' arrays and files begin with."""


@dataclass(frozen=True)
class Header:
    """What ``dataset.json`` says."""

    format: str
    schema: int
    settings: dict[str, Any]
    """How it was collected."""
    layout: Any
    kinds: list[str] = field(default_factory=list)
    clouds: list[tuple[float, float, float]] | None = None
    """Canonical points of all entities, in version 0.1; now each asset has a file."""

    @property
    def task(self) -> str:
        """The task's name."""
        return str(self.settings["task"])


@dataclass(frozen=True)
class Dataset:
    """Episodes of one split and the canonical clouds of the assets that occur in them."""

    task: str
    layout: Layout
    assets: Mapping[str, np.ndarray]
    """Asset -> canonical points (n, 3), float32, metres."""
    episodes: tuple[Episode, ...]

    def __post_init__(self) -> None:
        """Raise :class:`DatasetError` where an episode has an asset that is unknown, or of another number of points."""
        for assets in {e.assets or self.layout.names for e in self.episodes}:
            if len(assets) != len(self.layout):
                raise DatasetError(f"an episode names assets {assets}; expected {len(self.layout)}, one an entity")
            for name, entity in zip(assets, self.layout, strict=True):
                if name not in self.assets:
                    raise unknown_name("asset", name, self.assets)
                if self.assets[name].shape != (entity.points, 3):
                    found = self.assets[name].shape
                    raise DatasetError(f"asset {name!r} has points {found}; expected {(entity.points, 3)}")
        for episode in self.episodes:
            if episode.poses.shape[1] != len(self.layout):
                raise DatasetError(f"an episode has {episode.poses.shape[1]} entities; expected {len(self.layout)}")

    def of_kinds(self, kinds: Sequence[str]) -> Dataset:
        """Only the episodes of these kinds."""
        for kind in kinds:
            if kind not in KINDS:
                raise unknown_name("kind of episode", kind, KINDS)
        chosen = {KINDS.index(kind) for kind in kinds}
        return replace(self, episodes=tuple(e for e in self.episodes if e.kind in chosen))

    def some(self, count: int) -> Dataset:
        """``count`` of the episodes, evenly chosen."""
        index = np.linspace(0, len(self.episodes) - 1, count).round().astype(int)
        return replace(self, episodes=tuple(self.episodes[i] for i in index))

    @cached_property
    def combinations(self) -> tuple[tuple[str, ...], ...]:
        """Every tuple of assets (E,) that some episode has."""
        return tuple(dict.fromkeys(e.assets or self.layout.names for e in self.episodes))

    @cached_property
    def clouds(self) -> np.ndarray:
        """Canonical points (K, N, 3) of each of :attr:`combinations`, float32."""
        return np.stack([np.concatenate([self.assets[name] for name in names]) for names in self.combinations])

    @cached_property
    def combination_of(self) -> np.ndarray:
        """Place (M,) of each episode's assets in :attr:`combinations`."""
        places = {names: k for k, names in enumerate(self.combinations)}
        return np.array([places[e.assets or self.layout.names] for e in self.episodes])

    def cloud(self, episode: Episode) -> np.ndarray:
        """Canonical points (N, 3) of an episode's assets, float32."""
        return self.clouds[self.combinations.index(episode.assets or self.layout.names)]

    def scene(self, episode: Episode, step: int = 0) -> Scene:
        """The scene at ``step`` of ``episode``, velocities included."""
        frames = [max(step - k, 0) for k in range(3)]
        return Scene(
            task=self.task,
            layout=self.layout,
            clouds=self.cloud(episode),
            poses=episode.poses[frames].astype(np.float64),
            goal=episode.goal,
            joints=episode.joints[step],
            last_action=episode.actions[step - 1] if step else None,
            assets=episode.assets,
        )


def read_header(folder: Path, task: str | None = None) -> Header:
    """The data set's description.

    Raises:
        DatasetError: no data set is there, or one of another task or a newer schema.
    """
    path = Path(folder) / "dataset.json"
    if not path.exists():
        raise DatasetError(f"{folder} is not a data set: it has no dataset.json (`pwm-gym collect` makes one)")
    header = read_json(path, Header, DatasetError)
    if header.format != FORMAT:
        raise DatasetError(f"{path} has format {header.format!r}; expected {FORMAT!r}")
    if header.schema > SCHEMA:
        raise DatasetError(f"{path} has schema {header.schema}; this version reads up to {SCHEMA}")
    if "task" not in header.settings:
        raise DatasetError(f"{path} names no task in its settings")
    if task is not None and header.task != task:
        raise DatasetError(f"{folder} is a data set of task {header.task!r}; expected {task!r}")
    return header


def asset_path(folder: Path, name: str) -> Path:
    """File of an asset's canonical cloud in a data set's folder."""
    return Path(folder) / f"{ASSET}{name}.npz"


def save_asset(folder: Path, name: str, cloud: np.ndarray) -> None:
    """Write an asset's canonical points (n, 3), unless they are there already."""
    if not (path := asset_path(folder, name)).exists():
        save_arrays(path, {"points": np.asarray(cloud, np.float32)})


def load_split(folder: Path | str, split: str, task: str | None = None) -> Dataset:
    """Every episode of ``split`` ("train", "validation" or "test") below ``folder``."""
    if split not in SPLITS:
        raise unknown_name("split", split, SPLITS)
    folder = Path(folder)
    header = read_header(folder, task)
    paths = sorted(folder.glob(f"{split}-*.npz"))
    if not paths:
        raise DatasetError(f"{folder} has no episodes of split {split!r} yet")
    try:
        layout = Layout.from_json(header.layout)
    except ValueError as error:
        raise DatasetError(f"{folder / 'dataset.json'}: {error}") from error
    episodes = tuple(episode for path in paths for episode in read_shard(path, header.task))
    return Dataset(header.task, layout, _assets(folder, header, layout), episodes)


def load_demonstrations(folder: Path | str, split: str, task: str | None = None) -> Dataset:
    """The demonstrations of ``split``, those that turn random too.

    Raises:
        DatasetError: there is no such data set, one of another task, or none of its episodes is a demonstration.
    """
    found = load_split(folder, split, task).of_kinds(DEMONSTRATIONS)
    if not found.episodes:
        raise DatasetError(f"{folder} has no demonstrations in its {split} split; expected some")
    return found


def load_splits(folder: Path, splits: Sequence[str] = (), kinds: Sequence[str] = ()) -> dict[str, Dataset]:
    """Split -> its episodes, of those splits that have any.

    Args:
        folder: of the data set.
        splits: none given takes all that are there.
        kinds: kinds of episodes (:data:`~pwm_gym.data.KINDS`); none given takes all.

    Raises:
        DatasetError: no data set is there, or none of these episodes.
    """
    read_header(folder)
    stored = splits or [split for split in SPLITS if any(folder.glob(f"{split}-*.npz"))]
    found = {split: load_split(folder, split) for split in stored}
    if kinds:
        found = {split: dataset.of_kinds(kinds) for split, dataset in found.items()}
    found = {split: dataset for split, dataset in found.items() if dataset.episodes}
    if not found:
        wanted = " of kinds " + ", ".join(kinds) if kinds else ""
        raise DatasetError(f"{folder} has no episodes{wanted} in {', '.join(stored) or 'any split'}")
    return found


def _assets(folder: Path, header: Header, layout: Layout) -> dict[str, np.ndarray]:
    """Canonical points of every asset of a data set."""
    if header.clouds is not None:
        clouds = np.asarray(header.clouds, np.float32)
        if clouds.shape != (layout.points, 3):
            raise DatasetError(f"{folder} has clouds of shape {clouds.shape}; expected {(layout.points, 3)}")
        return {e.name: clouds[e.slice] for e in layout}
    found = {}
    for path in sorted(folder.glob(f"{ASSET}*.npz")):
        arrays, _ = load_arrays(path, "is truncated or no asset's file; delete it and collect again", DatasetError)
        if "points" not in arrays:
            raise DatasetError(f"{path} is no asset's file (it lacks points)")
        found[path.stem.removeprefix(ASSET)] = arrays["points"].astype(np.float32)
    return found
