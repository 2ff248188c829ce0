"""Exports have the layout, the columns and the values that LeRobot's format v3.0 asks for."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pwm_gym.cli import main
from pwm_gym.data import load_split
from pwm_gym.data.lerobot_format import export_lerobot
from pwm_gym.errors import DatasetError, PwmGymError
from pwm_gym.tasks import TASKS, get_task

pq = pytest.importorskip("pyarrow.parquet")

_FRAMES = "data/chunk-000/file-000.parquet"
_EPISODES = "meta/episodes/chunk-000/file-000.parquet"


@pytest.fixture
def folder(worlds, recorder, tmp_path) -> Path:
    """Three episodes of 6, 7 and 8 steps in training, of which the last is practice, and as many in test."""
    dataset = recorder.dataset(worlds["cube"], "PickCube")
    episodes = tuple(replace(e, kind=2 if k == 2 else 0) for k, e in enumerate(dataset.episodes))
    for split in ("train", "test"):
        recorder.write(replace(dataset, episodes=episodes), tmp_path / "own", split)
    return tmp_path / "own"


@pytest.fixture
def out(folder, tmp_path) -> Path:
    return export_lerobot(folder, tmp_path / "lerobot")


def info_of(out: Path) -> dict:
    return json.loads((out / "meta" / "info.json").read_text())


def column(table, name: str) -> np.ndarray:
    """Values (F, n), or (F,), of a column."""
    return np.array(table[name].to_pylist())


def test_every_frame_is_there(folder, out):
    table = pq.read_table(out / _FRAMES)
    episodes = load_split(folder, "train").episodes
    owner = column(table, "episode_index")
    assert np.array_equal(np.bincount(owner), [6, 7, 8])
    assert np.array_equal(column(table, "index"), np.arange(21))
    for k, episode in enumerate(episodes):
        rows = table.filter(owner == k)
        assert np.array_equal(column(rows, "frame_index"), np.arange(len(episode)))
        assert np.array_equal(column(rows, "action").astype(np.float32), episode.actions)
        assert np.array_equal(column(rows, "observation.state").astype(np.float32), episode.joints[:-1, 0])
        surroundings = column(rows, "observation.environment_state").astype(np.float32)
        assert np.array_equal(surroundings[:, :-3], episode.poses[:-1].reshape(len(episode), -1))
        assert np.array_equal(surroundings[:, -3:], np.tile(episode.goal, (len(episode), 1)))
        assert np.array_equal(column(rows, "next.reward").astype(np.float32), episode.rewards)
        assert np.array_equal(column(rows, "next.success"), episode.success)
        assert np.flatnonzero(column(rows, "next.done")).tolist() == [len(episode) - 1]
        np.testing.assert_allclose(column(rows, "timestamp"), 0.05 * np.arange(len(episode)), atol=1e-6)


def test_the_columns_are_those_of_info_json(out):
    info = info_of(out)
    assert info["codebase_version"] == "v3.0" and info["fps"] == 20 and info["robot_type"] == "panda"
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 21, 1)
    assert info["splits"] == {"train": "0:3"}
    assert (out / info["data_path"].format(chunk_index=0, file_index=0)).exists()
    schema = pq.read_schema(out / _FRAMES)
    assert set(schema.names) == set(info["features"])
    for name, feature in info["features"].items():
        kind = schema.field(name).type
        if feature["shape"] != [1]:
            assert kind.list_size == feature["shape"][0] == len(feature["names"])
            kind = kind.value_type
        assert str(kind) == {"float32": "float"}.get(feature["dtype"], feature["dtype"])
    names = info["features"]["observation.environment_state"]["names"]
    assert names[:2] == ["hand.x", "hand.y"] and names[-4:] == ["cube.qz", "goal.0", "goal.1", "goal.2"]
    for name in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
        assert info["features"][name]["shape"] == [1]


def test_episodes_say_where_their_frames_are(out):
    table = pq.read_table(out / _EPISODES)
    assert column(table, "dataset_from_index").tolist() == [0, 6, 13]
    assert column(table, "dataset_to_index").tolist() == [6, 13, 21]
    assert column(table, "length").tolist() == [6, 7, 8]
    assert column(table, "data/chunk_index").tolist() == column(table, "data/file_index").tolist() == [0, 0, 0]
    assert table["tasks"].to_pylist() == [[get_task("PickCube").description]] * 3
    frames = pq.ParquetFile(out / _FRAMES)
    assert frames.num_row_groups == 3  # one an episode
    actions = column(frames.read_row_group(1), "action")
    np.testing.assert_allclose(column(table, "stats/action/mean")[1], actions.mean(0))
    assert column(table, "stats/action/count").tolist() == [[6], [7], [8]]


def test_statistics_are_those_of_all_frames(out):
    stats = json.loads((out / "meta" / "stats.json").read_text())
    table = pq.read_table(out / _FRAMES)
    assert stats.keys() == set(table.column_names)
    actions = column(table, "action")
    for name, value in {"min": actions.min(0), "max": actions.max(0), "std": actions.std(0)}.items():
        np.testing.assert_allclose(stats["action"][name], value)
    np.testing.assert_allclose(stats["action"]["q90"], np.quantile(actions, 0.9, axis=0))
    assert stats["next.reward"]["count"] == [21] and len(stats["next.reward"]["mean"]) == 1


def test_tasks_are_indexed_by_their_text_in_pandas(out):
    table = pq.read_table(out / "meta" / "tasks.parquet")
    assert table.to_pydict() == {"task_index": [0], "task": [get_task("PickCube").description]}
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def test_files_stay_below_their_size(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("pwm_gym.data.lerobot_format._FILE_MEGABYTES", 14 * 300 / 2**20)  # 14 frames or so
    out = export_lerobot(folder, tmp_path / "small", ["train", "test"])
    files = sorted(path.relative_to(out) for path in (out / "data").rglob("*.parquet"))
    assert len(files) > 1
    table = pq.read_table(out / _EPISODES)
    for k, (chunk, file) in enumerate(
        zip(column(table, "data/chunk_index"), column(table, "data/file_index"), strict=True)
    ):
        path = out / info_of(out)["data_path"].format(chunk_index=chunk, file_index=file)
        assert k in column(pq.read_table(path), "episode_index")
    assert sum(pq.read_metadata(out / file).num_rows for file in files) == 42
    assert info_of(out)["splits"] == {"train": "0:3", "test": "3:6"}


def test_the_command_writes_the_kinds_that_are_asked_for(folder, tmp_path, capsys):
    out = tmp_path / "expert"
    main(["data", "export", "--data", str(folder), "--to", "lerobot", "--out", str(out), "--kinds", "expert"])
    assert f"LeRobot data set: {out}" in capsys.readouterr().out
    assert info_of(out)["total_episodes"] == 2
    with pytest.raises(SystemExit, match="expected a new folder"):
        main(["data", "export", "--data", str(folder), "--to", "lerobot", "--out", str(out)])
    with pytest.raises(SystemExit, match="--id x; a LeRobot data set has a folder"):
        main(["data", "export", "--data", str(folder), "--to", "lerobot", "--id", "x"])


def test_what_cannot_be_exported_is_named(folder, tmp_path, monkeypatch):
    with pytest.raises(DatasetError, match="has no episodes of kinds on_policy in train"):
        export_lerobot(folder, tmp_path / "none", kinds=["on_policy"])
    task = TASKS["PickCube"]
    control = replace(task.robot.control, period=0.03)
    monkeypatch.setitem(TASKS, "PickCube", replace(task, robot=replace(task.robot, control=control)))
    with pytest.raises(DatasetError, match=r"control period of 0.03 s; expected a whole number of steps a second"):
        export_lerobot(folder, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_without_pyarrow_the_extra_is_named(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(PwmGymError, match=r"pip install 'pwm-gym\[lerobot\]'"):
        export_lerobot(folder, tmp_path / "none")


def test_lerobot_itself_reads_it(out):
    lerobot = pytest.importorskip("lerobot.datasets.lerobot_dataset", exc_type=ImportError)
    dataset = lerobot.LeRobotDataset("local/test", root=out, delta_timestamps={"action": [0.0, 0.05]})
    assert len(dataset) == 21 and dataset.num_episodes == 3
    assert dataset[6]["action"].shape == (2, 7) and int(dataset[6]["episode_index"]) == 1
    assert dataset[0]["task"] == get_task("PickCube").description
