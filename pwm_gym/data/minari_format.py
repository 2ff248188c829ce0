"""Export to and import from Minari, Farama's format of offline data sets.

Observations are entity poses, joints and the goal, not points: with the canonical clouds they give the points, and a
data set stays small. What Minari has no place for (canonical clouds, layout, names of assets, how it was collected)
lies in one file beside its own, so that an import gives back the data set that was exported.
"""

from __future__ import annotations

import copy
import shutil
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from pwm_gym.data.dataset import ASSET, SPLITS, Dataset, load_split, load_splits, read_header
from pwm_gym.data.episodes import KINDS, Episode
from pwm_gym.data.minari_adroit import ENVIRONMENTS, TOLERANCE, environment_of, import_adroit
from pwm_gym.data.minari_store import load_source, place_of, read_episodes, write_folder
from pwm_gym.errors import DatasetError
from pwm_gym.files import load_arrays, new_folder, save_arrays
from pwm_gym.scene import SCHEMA, Layout
from pwm_gym.tasks import get_task

__all__ = ["FORMAT", "SIDE_FILE", "export_minari", "import_minari"]

FORMAT = "pwm_gym.minari"
SIDE_FILE = "pwm_gym.npz"
"""Name of the file beside Minari's own."""

_SPAN = 1e3  # Minari wants bounded spaces; nothing in a scene comes near
_OBSERVATIONS = ("poses", "joints", "goal")
_INFOS = ("success", "grasped", "kind", "seed", "switch", "split", "assets")
_OWN = -1  # combination of an episode that names no assets: those of the layout


@dataclass(frozen=True)
class _Header:
    """What the side file says beside the canonical clouds."""

    format: str
    schema: int
    settings: dict[str, Any]
    layout: Any
    combinations: list[tuple[str, ...]]
    """Names (E,) of the assets that an episode's number of a combination stands for."""


def export_minari(folder: Path | str, dataset_id: str, splits: Sequence[str] = (), kinds: Sequence[str] = ()) -> Any:
    """Create the Minari data set ``dataset_id`` of the episodes in a data set's folder.

    ``infos["split"]`` is an episode's place in :data:`~pwm_gym.data.dataset.SPLITS`, ``infos["kind"]`` its place in
    :data:`~pwm_gym.data.KINDS`; ``recover_environment()`` gives the simulator twin.

    Args:
        folder: data set that collection or an import wrote.
        dataset_id: Minari's name, such as ``"pwm/PickCube/collected-v0"``; Minari says where it stores it
            (``MINARI_DATASETS_PATH``).
        splits: splits to export; none given takes all that there are.
        kinds: kinds of episodes to export; none given takes all.

    Returns:
        The ``minari.MinariDataset``.

    Raises:
        DatasetError: no data set is there, none of its episodes is asked for, Minari has one of this name already, or
            the name is none of Minari's form.
    """
    header = read_header(Path(folder))
    sources = load_splits(Path(folder), splits, kinds)
    place = place_of(dataset_id)
    if place.exists():
        raise DatasetError(f"Minari has a data set {dataset_id!r} already ({place}); expected a new name or version")
    try:
        _write(sources, dataset_id, header.settings)
        _write_side_file(place / "data" / SIDE_FILE, sources, header.settings)
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)  # half of a data set is none
        raise
    import minari

    return minari.load_dataset(dataset_id)


def _write(sources: Mapping[str, Dataset], dataset_id: str, settings: Mapping[str, Any]) -> None:
    """Write Minari's own files."""
    import minari
    from minari.data_collector import EpisodeBuffer

    dataset = next(iter(sources.values()))
    task, first = get_task(dataset.task), dataset.episodes[0]
    shapes = {"poses": first.poses.shape[1:], "joints": first.joints.shape[1:], "goal": first.goal.shape}
    spaces: dict[str, gym.Space[Any]] = {
        name: gym.spaces.Box(-_SPAN, _SPAN, shape, np.float32) for name, shape in shapes.items()
    }
    combinations = _combinations(sources)
    rows = [(split, episode) for split, source in sources.items() for episode in source.episodes]
    buffers = [
        EpisodeBuffer(id=i, seed=episode.seed, **_arrays(episode, SPLITS.index(split), combinations))
        for i, (split, episode) in enumerate(rows)
    ]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="minari")  # of an author and a link that it would like to have
        written = minari.create_dataset_from_buffers(
            dataset_id,
            buffers,
            observation_space=gym.spaces.Dict(spaces),
            action_space=gym.spaces.Box(-1.0, 1.0, (task.action_size,), np.float32),
            algorithm_name="scripted expert",
            description=f"{task.name} of pwm_gym: {task.description} Poses of {', '.join(dataset.layout.names)}.",
            requirements=["pwm-gym"],
        )
    spec = copy.deepcopy(gym.spec(f"pwm/{task.name}Sim-v0"))
    if objects := settings.get("objects"):
        spec.kwargs["objects"] = objects
    written.storage.update_metadata({"env_spec": spec.to_json()})  # given earlier, Minari would start the simulator


def _combinations(sources: Mapping[str, Dataset]) -> list[tuple[str, ...]]:
    """Every tuple of assets (E,) that some episode names."""
    named = [episode.assets for source in sources.values() for episode in source.episodes if episode.assets]
    return list(dict.fromkeys(named))


def _arrays(episode: Episode, split: int, combinations: Sequence[tuple[str, ...]]) -> dict[str, Any]:
    """An episode's values in Minari's form; per-episode ones are repeated at every step."""
    steps = len(episode)
    ended = bool(episode.success[-1])
    constant = {
        "kind": episode.kind,
        "seed": episode.seed,
        "switch": episode.switch,
        "split": split,
        "assets": combinations.index(episode.assets) if episode.assets else _OWN,
    }
    infos = {name: np.full(steps + 1, value) for name, value in constant.items()}
    infos["success"] = np.concatenate([[False], episode.success])
    infos["grasped"] = np.concatenate([[False], episode.grasped])
    return {
        "observations": {
            "poses": episode.poses,
            "joints": episode.joints,
            "goal": np.repeat(episode.goal[None], steps + 1, 0),
        },
        "actions": episode.actions,
        "rewards": episode.rewards.tolist(),
        "terminations": [False] * (steps - 1) + [ended],
        "truncations": [False] * (steps - 1) + [not ended],
        "infos": infos,
    }


def _write_side_file(path: Path, sources: Mapping[str, Dataset], settings: Mapping[str, Any]) -> None:
    """Write the canonical clouds, and what else an import needs."""
    dataset = next(iter(sources.values()))
    clouds = {f"{ASSET}{name}": points for source in sources.values() for name, points in source.assets.items()}
    header = {
        "format": FORMAT,
        "schema": SCHEMA,
        "settings": dict(settings),
        "layout": dataset.layout.to_json(),
        "combinations": _combinations(sources),
    }
    save_arrays(path, clouds, header)


def import_minari(
    dataset_id: str,
    folder: Path | str,
    task: str | None = None,
    download: bool = False,
    progress: bool = False,
    tolerance: float = TOLERANCE,
    split_seed: int = 0,
    follow: bool = False,
) -> Path:
    """Write the episodes of a Minari data set into a folder that training accepts.

    It is one that :func:`export_minari` made, or demonstrations of one of Gymnasium-Robotics' Adroit environments
    (:func:`~pwm_gym.data.minari_adroit.import_adroit`).

    Args:
        dataset_id: Minari's name.
        folder: new folder of the data set; it appears when all of it is there.
        task: registered task that the data must be of; None takes what it is of.
        download: whether to fetch it from Minari's remote where it is not on this machine.
        progress: whether to show a bar.
        tolerance: of demonstrations: metres and radians by which a replay may stray from its recording.
        split_seed: of demonstrations: of the draw that parts them into training, validation and test.
        follow: of demonstrations: whether positions are put back to the recorded ones after each step.

    Raises:
        DatasetError: it is not there, foreign, damaged, of another task, schema or action size, or ``folder`` is taken.
    """
    with new_folder(Path(folder), DatasetError) as root:
        source = load_source(dataset_id, download)
        if environment_of(source) in ENVIRONMENTS:
            splits = import_adroit(source, dataset_id, root, task, tolerance, split_seed, progress, follow)
        else:
            splits = _import_exported(source, dataset_id, root, task, progress)
        for split in splits:
            load_split(root, split)  # what does not fit is found here, not in a training
    return Path(folder)


def _import_exported(source: Any, dataset_id: str, root: Path, task: str | None, progress: bool) -> list[str]:
    """Write a data set that was exported into ``root``, and tell its splits."""
    path = place_of(dataset_id) / "data" / SIDE_FILE
    if not path.exists():
        environment = environment_of(source) or "no environment"
        raise DatasetError(
            f"{dataset_id!r} has no {SIDE_FILE} and is of {environment}; expected a data set that "
            f"`pwm-gym data export` wrote, or one of {' or '.join(ENVIRONMENTS)}"
        )
    clouds, header = _read_side_file(path, dataset_id)
    layout = _check(source, dataset_id, header, task)
    by_split = _episodes(source, dataset_id, layout, header, progress)
    write_folder(root, by_split, clouds, {**header.settings, "imported": dataset_id}, layout)
    return [*by_split]


def _read_side_file(path: Path, dataset_id: str) -> tuple[dict[str, np.ndarray], _Header]:
    """Canonical points of each asset, and the header."""
    arrays, header = load_arrays(path, "is truncated or foreign; export again", DatasetError, FORMAT, _Header)
    if header.schema > SCHEMA:
        raise DatasetError(f"{dataset_id!r} has schema {header.schema}; this version reads up to {SCHEMA}")
    if not isinstance(header.settings.get("task"), str):
        raise DatasetError(f"{path} names no task in its settings")
    return {name.removeprefix(ASSET): points for name, points in arrays.items()}, header


def _check(source: Any, dataset_id: str, header: _Header, task: str | None) -> Layout:
    """Layout of a Minari data set that fits a registered task.

    Raises:
        DatasetError: it does not.
    """
    found = header.settings["task"]
    if task is not None and found != task:
        raise DatasetError(f"{dataset_id!r} is a data set of task {found!r}; expected {task!r}")
    observations, actions = source.spec.observation_space, source.spec.action_space
    if not isinstance(observations, gym.spaces.Dict) or set(observations) != set(_OBSERVATIONS):
        raise DatasetError(f"{dataset_id!r} has observations {observations}; expected a Dict of poses, joints and goal")
    size = get_task(found).action_size
    if actions.shape != (size,):
        raise DatasetError(f"{dataset_id!r} has actions of shape {actions.shape}; task {found!r} expects {(size,)}")
    try:
        return Layout.from_json(header.layout)
    except ValueError as error:
        raise DatasetError(f"{dataset_id!r}: {error}") from error


def _episodes(
    source: Any, dataset_id: str, layout: Layout, header: _Header, progress: bool
) -> dict[str, list[Episode]]:
    """Split -> its episodes."""
    from tqdm import tqdm

    by_split: dict[str, list[Episode]] = {}
    rows = read_episodes(source, dataset_id)
    for data in tqdm(rows, total=source.total_episodes, unit="episode", disable=not progress):
        try:
            split, episode = _episode(data, header.combinations)
        except (IndexError, KeyError, TypeError, ValueError) as error:
            raise DatasetError(f"{dataset_id!r}, episode {data.id}: {error}") from error
        if episode.poses.shape[1:] != (len(layout), 7):
            shape = episode.poses.shape
            raise DatasetError(f"{dataset_id!r}, episode {data.id}: poses {shape}; expected {len(layout)} entities")
        by_split.setdefault(split, []).append(episode)
    return by_split


def _episode(data: Any, combinations: Sequence[tuple[str, ...]]) -> tuple[str, Episode]:
    """Split of an episode in Minari's form, and the episode."""
    infos = data.infos or {}
    if missing := [name for name in _INFOS if name not in infos]:
        raise DatasetError(f"it lacks infos {', '.join(missing)}")
    kind = _one(infos, "kind", range(len(KINDS)))
    split = SPLITS[_one(infos, "split", range(len(SPLITS)))]
    assets = _one(infos, "assets", range(_OWN, len(combinations)))
    return split, Episode(
        poses=np.asarray(data.observations["poses"], np.float32),
        joints=np.asarray(data.observations["joints"], np.float32),
        actions=np.asarray(data.actions, np.float32),
        rewards=np.asarray(data.rewards, np.float32),
        success=np.asarray(infos["success"][1:], bool),
        grasped=np.asarray(infos["grasped"][1:], bool),
        goal=np.asarray(data.observations["goal"][0], np.float32),
        kind=kind,
        seed=int(infos["seed"][0]),
        switch=int(infos["switch"][0]),
        assets=() if assets == _OWN else combinations[assets],
    )


def _one(infos: Mapping[str, Any], name: str, known: range) -> int:
    """A per-episode value, one of ``known``."""
    value = int(infos[name][0])
    if value not in known:
        raise DatasetError(f"{name} {value}; expected {known.start} to {known.stop - 1}")
    return value
