"""Export to LeRobot's data set format (LeRobotDataset v3.0), so that its policies can be trained on our episodes.

Three tables in Parquet and two JSON files: frames (``data``), episodes and tasks (``meta``), and what they hold
(``meta/info.json``) with statistics that policies normalise by (``meta/stats.json``). A frame is what was seen before
an action, the action, and what came of it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pwm_gym.data.dataset import Dataset, load_splits
from pwm_gym.data.episodes import Episode
from pwm_gym.errors import DatasetError, PwmGymError
from pwm_gym.files import new_folder
from pwm_gym.tasks import Task, get_task

__all__ = ["VERSION", "export_lerobot"]

VERSION = "v3.0"
"""Version of LeRobot's format."""

_CHUNK = 1000  # files a folder, as LeRobot writes
_FILE_MEGABYTES = 100  # of a file of frames, uncompressed
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_CARD = """---
task_categories:
- robotics
tags:
- LeRobot
configs:
- config_name: default
  data_files: data/*/*.parquet
---

{description}

Recorded in a simulator by pwm_gym, task {task}, in LeRobot's format {version}. Positions are in metres in the frame of
the robot's base, quaternions are (w, x, y, z), a frame lasts {period} seconds. `observation.state` holds the robot's
joint positions, `observation.environment_state` the pose of every entity and then the task's goal.
"""


def export_lerobot(
    folder: Path | str, out: Path | str, splits: Sequence[str] = ("train",), kinds: Sequence[str] = ()
) -> Path:
    """Write the episodes in a data set's folder in LeRobot's format.

    Frame t of an episode of T steps has the joints and poses before action t, the action, and the reward and success
    after it; what is seen after the last action is left out, as LeRobot's own recordings do.

    Args:
        folder: data set that collection or an import wrote.
        out: new folder; ``LeRobotDataset(name, root=out)`` reads it. It appears when all of it is there.
        splits: splits to export; LeRobot trains on all that it finds, whatever ``info.json`` says of splits.
        kinds: kinds of episodes to export (:data:`~pwm_gym.data.KINDS`), such as the expert's; none given takes all.

    Raises:
        DatasetError: no data set is there, none of its episodes is asked for, the task's control period is no whole
            number of frames a second, or ``out`` is taken.
        PwmGymError: pyarrow is not installed.
    """
    try:
        import pyarrow  # noqa: F401
    except ModuleNotFoundError as error:
        raise PwmGymError(f"{error}; pip install 'pwm-gym[lerobot]'") from error
    sources = load_splits(Path(folder), splits, kinds)
    dataset = next(iter(sources.values()))
    task = get_task(dataset.task)
    fps = _frames_per_second(task)
    episodes = [episode for source in sources.values() for episode in source.episodes]
    columns = _columns(episodes, fps)
    places = _places(episodes, columns)
    with new_folder(Path(out), DatasetError) as root:
        _write_frames(root, columns, places)
        _write_episodes(root, episodes, columns, places, task.description)
        _write_tasks(root, task.description)
        features = _features(columns, _names(dataset, columns))
        _write_json(root / "meta" / "info.json", _info(task, fps, features, sources))
        _write_json(root / "meta" / "stats.json", {name: _statistics(values) for name, values in columns.items()})
        card = _CARD.format(
            description=task.description, task=task.name, version=VERSION, period=task.control.period
        )  # fmt: skip
        (root / "README.md").write_text(card)
    return Path(out)


def _frames_per_second(task: Task) -> int:
    """Control steps a second.

    Raises:
        DatasetError: it is no whole number, which the format needs.
    """
    fps = round(1.0 / task.control.period)
    if abs(fps * task.control.period - 1.0) > 1e-6:
        told = f"task {task.name!r} has a control period of {task.control.period} s"
        raise DatasetError(f"{told}; expected a whole number of steps a second")
    return fps


def _columns(episodes: Sequence[Episode], fps: int) -> dict[str, np.ndarray]:
    """Feature -> its values (F, n), or (F,), of all frames."""
    lengths = np.array([len(e) for e in episodes])
    frame = np.concatenate([np.arange(length) for length in lengths])
    ends = np.cumsum(lengths) - 1
    done = np.zeros(len(frame), bool)
    done[ends] = True
    surroundings = [np.hstack([e.poses[:-1].reshape(len(e), -1), np.tile(e.goal, (len(e), 1))]) for e in episodes]
    return {
        "observation.state": np.concatenate([e.joints[:-1, 0] for e in episodes]).astype(np.float32),
        "observation.environment_state": np.concatenate(surroundings).astype(np.float32),
        "action": np.concatenate([e.actions for e in episodes]).astype(np.float32),
        "next.reward": np.concatenate([e.rewards for e in episodes]).astype(np.float32),
        "next.success": np.concatenate([e.success for e in episodes]).astype(bool),
        "next.done": done,
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.repeat(np.arange(len(episodes)), lengths),
        "index": np.arange(len(frame)),
        "task_index": np.zeros(len(frame), np.int64),
    }


def _names(dataset: Dataset, columns: Mapping[str, np.ndarray]) -> dict[str, list[str]]:
    """Feature -> a name for each of its numbers."""
    joints, actions = columns["observation.state"].shape[1], columns["action"].shape[1]
    poses = [f"{entity}.{part}" for entity in dataset.layout.names for part in _POSE]
    goal = columns["observation.environment_state"].shape[1] - len(poses)
    return {
        "observation.state": [f"joint_{k}" for k in range(joints)],
        "observation.environment_state": [*poses, *(f"goal.{k}" for k in range(goal))],
        "action": [f"action_{k}" for k in range(actions)],
    }


def _features(columns: Mapping[str, np.ndarray], names: Mapping[str, list[str]]) -> dict[str, Any]:
    """What ``info.json`` says of each feature."""
    return {
        name: {
            "dtype": str(values.dtype),
            "shape": [1] if values.ndim == 1 else [values.shape[1]],
            "names": names.get(name),
        }
        for name, values in columns.items()
    }


def _info(task: Task, fps: int, features: Mapping[str, Any], sources: Mapping[str, Dataset]) -> dict[str, Any]:
    """Content of ``info.json``."""
    ranges: dict[str, str] = {}
    start = 0
    for split, source in sources.items():
        stop = start + len(source.episodes)
        ranges[split] = f"{start}:{stop}"
        start = stop
    return {
        "codebase_version": VERSION,
        "robot_type": task.robot.name,
        "total_episodes": start,
        "total_frames": sum(len(e) for source in sources.values() for e in source.episodes),
        "total_tasks": 1,
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": _FILE_MEGABYTES,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": ranges,
        "data_path": f"data/{_FILE}",
        "video_path": None,
        "features": features,
    }


def _places(episodes: Sequence[Episode], columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Number (M,) of the file that each episode's frames go to."""
    frame = sum(values.nbytes // len(values) for values in columns.values())  # bytes
    places: list[int] = []
    number, filled = 0, 0
    for episode in episodes:
        size = frame * len(episode)
        if filled and filled + size > _FILE_MEGABYTES * 2**20:
            number, filled = number + 1, 0
        places.append(number)
        filled += size
    return np.array(places)


def _file(number: int) -> str:
    """Path of a file below its kind's folder."""
    return _FILE.format(chunk_index=number // _CHUNK, file_index=number % _CHUNK)


def _write_frames(root: Path, columns: Mapping[str, np.ndarray], places: np.ndarray) -> None:
    """Write the frames, one row group an episode, so that readers can fetch one alone."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: _arrow(values) for name, values in columns.items()})
    bounds = np.searchsorted(columns["episode_index"], np.arange(len(places) + 1))
    for number in np.unique(places):
        path = root / "data" / _file(int(number))
        path.parent.mkdir(parents=True, exist_ok=True)
        with pq.ParquetWriter(path, table.schema) as writer:
            for k in np.flatnonzero(places == number):
                writer.write_table(table.slice(bounds[k], bounds[k + 1] - bounds[k]))


def _arrow(values: np.ndarray) -> Any:
    """A column of numbers, or of lists of a fixed size."""
    import pyarrow as pa

    flat = pa.array(np.ascontiguousarray(values).ravel())
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _write_episodes(
    root: Path, episodes: Sequence[Episode], columns: Mapping[str, np.ndarray], places: np.ndarray, text: str
) -> None:
    """Write the table of episodes: where their frames are, and their statistics."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    lengths = np.array([len(e) for e in episodes])
    stops = np.cumsum(lengths)
    table: dict[str, Any] = {
        "episode_index": np.arange(len(episodes)),
        "tasks": [[text]] * len(episodes),
        "length": lengths,
        "data/chunk_index": places // _CHUNK,
        "data/file_index": places % _CHUNK,
        "dataset_from_index": stops - lengths,
        "dataset_to_index": stops,
        "meta/episodes/chunk_index": np.zeros_like(lengths),
        "meta/episodes/file_index": np.zeros_like(lengths),
    }
    for name, values in columns.items():
        rows = [_statistics(values[stop - length : stop]) for stop, length in zip(stops, lengths, strict=True)]
        table |= {f"stats/{name}/{kind}": [row[kind] for row in rows] for kind in rows[0]}
    path = root / "meta" / "episodes" / _file(0)
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(table), path)


def _statistics(values: np.ndarray) -> dict[str, list[float] | list[int]]:
    """What LeRobot keeps of a feature's values (F, n), or (F,): a list of n numbers each, and their count."""
    rows = values.reshape(len(values), -1).astype(np.float64)
    found: dict[str, list[float] | list[int]] = {
        "min": rows.min(0).tolist(),
        "max": rows.max(0).tolist(),
        "mean": rows.mean(0).tolist(),
        "std": rows.std(0).tolist(),
        "count": [len(rows)],
    }
    quantiles = np.quantile(rows, list(_QUANTILES.values()), axis=0)
    return found | {name: quantile.tolist() for name, quantile in zip(_QUANTILES, quantiles, strict=True)}


def _write_tasks(root: Path, text: str) -> None:
    """Write the table of tasks, whose index in pandas is the task's text."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def described(name: str, kind: str, stored: str) -> dict[str, Any]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored, "metadata": None}

    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [described("task_index", "int64", "int64"), described("task", "unicode", "object")],
    }
    table = pa.table({"task_index": [0], "task": [text]})
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), root / "meta" / "tasks.parquet")


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=4))
