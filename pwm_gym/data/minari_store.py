"""What every import from Minari needs: where its data sets are, their episodes, and the folder that is written."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pwm_gym.data.dataset import FORMAT as DATASET
from pwm_gym.data.dataset import save_asset
from pwm_gym.data.episodes import FORMAT as EPISODES
from pwm_gym.data.episodes import KINDS, Episode, write_shard
from pwm_gym.errors import DatasetError
from pwm_gym.files import write_atomically
from pwm_gym.scene import SCHEMA, Layout

__all__ = ["load_source", "place_of", "read_episodes", "write_folder"]

_SHARD = 100  # episodes a file of an imported data set


def place_of(dataset_id: str) -> Path:
    """Folder in which Minari stores a data set of this name.

    Raises:
        DatasetError: the name is not of Minari's form.
    """
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage.datasets_root_dir import get_dataset_path

    try:
        parse_dataset_id(dataset_id)
    except (TypeError, ValueError) as error:
        told = f"{dataset_id!r} is no name of a Minari data set; expected one such as 'pwm/PickCube/collected-v0'"
        raise DatasetError(told) from error
    return Path(get_dataset_path(dataset_id))


def load_source(dataset_id: str, download: bool) -> Any:
    """The Minari data set.

    Raises:
        DatasetError: Minari does not have it, or cannot read it.
    """
    import minari

    place = place_of(dataset_id)
    if not download and not (place / "data").is_dir():
        known = ", ".join(minari.list_local_datasets()) or "none"
        raise DatasetError(f"Minari has no data set {dataset_id!r} on this machine ({place}); it has {known}")
    try:
        return minari.load_dataset(dataset_id, download=download)
    except Exception as error:  # h5py's, JSON's, the network's: all about this one data set
        raise DatasetError(f"Minari cannot read {dataset_id!r} ({error})") from error


def read_episodes(source: Any, dataset_id: str) -> Iterator[Any]:
    """Episodes in Minari's form.

    Raises:
        DatasetError: one cannot be read.
    """
    try:
        yield from source.iterate_episodes()
    except (OSError, KeyError, ValueError, AssertionError) as error:
        raise DatasetError(f"Minari cannot read {dataset_id!r} ({error})") from error


def write_folder(
    folder: Path,
    by_split: Mapping[str, Sequence[Episode]],
    clouds: Mapping[str, np.ndarray],
    settings: Mapping[str, Any],
    layout: Layout,
) -> None:
    """Write a data set's folder as collection does."""
    for name, points in clouds.items():
        save_asset(folder, name, points)
    shard = {"format": EPISODES, "schema": SCHEMA, "task": settings["task"]}
    for split, episodes in by_split.items():
        for start in range(0, len(episodes), _SHARD):
            path = folder / f"{split}-imported-{start // _SHARD:05d}.npz"
            write_shard(path, episodes[start : start + _SHARD], shard)
    header = {"format": DATASET, "schema": SCHEMA, "settings": settings}
    header |= {"layout": layout.to_json(), "kinds": list(KINDS)}
    write_atomically(folder / "dataset.json", json.dumps(header).encode())
