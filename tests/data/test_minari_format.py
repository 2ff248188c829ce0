"""Data sets go to Minari and come back as they were."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from pwm_gym.cli import main
from pwm_gym.data import Episode, load_split
from pwm_gym.data.dataset import read_header
from pwm_gym.data.minari_format import SIDE_FILE, export_minari, import_minari
from pwm_gym.dynamics import load_checkpoint
from pwm_gym.errors import DatasetError, UnknownNameError
from pwm_gym.files import save_arrays
from pwm_gym.training import FitConfig, fit
from pwm_gym.training.losses import TrainConfig

minari = pytest.importorskip("minari")

ID = "pwm/PickCube/test-v0"


@pytest.fixture(autouse=True)
def minari_folder(tmp_path, monkeypatch) -> Path:
    """Where Minari stores its data sets."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path / "minari"


@pytest.fixture
def folder(worlds, recorder, tmp_path) -> Path:
    """PickCube's cubes of three sizes, in training and test."""
    dataset = recorder.several(worlds["cube"], "PickCube")
    kinds = tuple(replace(e, kind=k % 4, switch=k - 1) for k, e in enumerate(dataset.episodes))
    dataset = replace(dataset, episodes=kinds)
    settings = {"task": "PickCube", "offset": 7}
    recorder.write(dataset, tmp_path / "own", "train", settings=settings)
    return recorder.write(replace(dataset, episodes=kinds[:2]), tmp_path / "own", "test", settings=settings)


def assert_same(first: Path, second: Path, split: str) -> None:
    """The splits of two folders hold the same, to the last bit."""
    a, b = load_split(first, split), load_split(second, split)
    assert a.layout == b.layout and a.task == b.task
    assert a.assets.keys() == b.assets.keys()
    for name in a.assets:
        assert np.array_equal(a.assets[name], b.assets[name])
    assert len(a.episodes) == len(b.episodes) > 0
    for one, other in zip(a.episodes, b.episodes, strict=True):
        for field in fields(Episode):
            before, after = getattr(one, field.name), getattr(other, field.name)
            assert np.array_equal(before, after), field.name
            assert getattr(before, "dtype", None) == getattr(after, "dtype", None), field.name


def test_there_and_back_nothing_is_lost(folder, tmp_path):
    export_minari(folder, ID)
    back = import_minari(ID, tmp_path / "back", "PickCube")
    for split in ("train", "test"):
        assert_same(folder, back, split)
    assert not list(back.glob("validation-*"))
    assert read_header(back).settings == {**read_header(folder).settings, "imported": ID}
    assert not list(tmp_path.glob(".back*"))


def test_episodes_without_names_of_assets_stay_without(worlds, recorder, tmp_path):
    plain = recorder.write(recorder.dataset(worlds["cube"], "PickCube", goal=0), tmp_path / "plain")
    export_minari(plain, ID)
    assert_same(plain, import_minari(ID, tmp_path / "back"), "train")


def test_only_the_splits_that_are_asked_for(folder, tmp_path):
    assert export_minari(folder, ID, ["test"]).total_episodes == 2
    back = import_minari(ID, tmp_path / "back")
    assert not list(back.glob("train-*"))
    assert_same(folder, back, "test")
    with pytest.raises(UnknownNameError, match="unknown split 'tst'"):
        export_minari(folder, "pwm/other-v0", ["tst"])


def test_minari_reads_splits_and_knows_the_twin(folder):
    export_minari(folder, ID)
    dataset = minari.load_dataset(ID)
    test = dataset.filter_episodes(lambda episode: episode.infos["split"][0] == 2)
    assert dataset.total_episodes == 8 and test.total_episodes == 2
    assert dataset.env_spec == gym.spec("pwm/PickCubeSim-v0")  # docs/data.md, which the tests run, recovers it
    assert dataset.spec.action_space.shape == (7,)


def test_the_twin_has_the_objects_of_the_data(worlds, recorder, tmp_path):
    settings = {"task": "PickYCB", "objects": "liftable"}
    data = recorder.write(recorder.dataset(worlds["cube"], "PickYCB"), tmp_path / "ycb", settings=settings)
    spec = export_minari(data, ID).env_spec
    assert spec.id == "pwm/PickYCBSim-v0" and spec.kwargs["objects"] == "liftable"
    assert "objects" not in gym.spec("pwm/PickYCBSim-v0").kwargs


def test_what_is_imported_can_be_trained_on(worlds, recorder, tmp_path, capsys):
    dataset = recorder.several(worlds["cube"], "PickCube")
    for split in ("train", "validation"):
        recorder.write(dataset, tmp_path / "own", split)
    main(["data", "export", "--data", str(tmp_path / "own"), "--id", ID])
    main(["data", "import", ID, "--out", str(tmp_path / "back")])
    settings = {"points": 8, "point_width": 8, "width": 16, "blocks": 1, "heads": 2, "arm_width": 8}
    config = FitConfig(
        data=(tmp_path / "back",), out=tmp_path / "run", settings=settings, arm_steps=3, error_steps=3
    )  # fmt: skip
    checkpoint = fit(config, TrainConfig(phases=((1, 4, 4),), validate_every=4, threads=1), lambda *_: {}, False)
    data = load_checkpoint(checkpoint).description["training"]["data"]
    assert data["tasks"] == {"PickCube": 6} and data["settings"][0]["imported"] == ID
    out = capsys.readouterr().out
    assert f"Minari data set {ID}: 12 episodes, 78 steps" in out and f"data set: {tmp_path / 'back'}" in out


def refused(*args) -> str:
    """What an import says."""
    with pytest.raises(DatasetError) as error:
        import_minari(*args)
    return str(error.value)


def test_names_that_cannot_be_or_are_taken_are_refused(folder):
    with pytest.raises(DatasetError, match="'no name!' is no name of a Minari data set; expected one such as"):
        export_minari(folder, "no name!")
    export_minari(folder, ID)
    with pytest.raises(DatasetError, match=f"Minari has a data set '{ID}' already"):
        export_minari(folder, ID)


def test_a_folder_that_is_taken_is_refused(folder):
    export_minari(folder, ID)
    assert refused(ID, folder) == f"{folder} holds something already; expected a new folder"
    assert_same(folder, folder, "train")


def test_a_data_set_that_is_not_there_is_named(folder, tmp_path):
    export_minari(folder, ID)
    told = refused("pwm/PickCub/test-v0", tmp_path / "back")
    assert "Minari has no data set 'pwm/PickCub/test-v0' on this machine" in told and told.endswith(f"it has {ID}")


def test_a_foreign_data_set_is_named(tmp_path):
    from minari.data_collector import EpisodeBuffer

    box = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
    values = {"observations": np.zeros((3, 2), np.float32), "actions": np.zeros((2, 2), np.float32)}
    ends = {"rewards": [0.0, 0.0], "terminations": [False, True], "truncations": [False, False]}
    minari.create_dataset_from_buffers(
        "other/thing-v0", [EpisodeBuffer(id=0, **values, **ends)], observation_space=box, action_space=box
    )
    told = refused("other/thing-v0", tmp_path / "back")
    assert f"'other/thing-v0' has no {SIDE_FILE} and is of no environment; expected a data set that" in told
    assert not (tmp_path / "back").exists()


def test_another_task_is_refused(folder, tmp_path):
    export_minari(folder, ID)
    told = refused(ID, tmp_path / "back", "StackCube")
    assert told == f"'{ID}' is a data set of task 'PickCube'; expected 'StackCube'"


def rewrite_header(minari_folder, **changes) -> None:
    """Change the side file's header."""
    path = minari_folder / ID / "data" / SIDE_FILE
    with np.load(path) as file:
        header = json.loads(str(file["header"]))
        arrays = {name: file[name] for name in file.files if name != "header"}
    save_arrays(path, arrays, {**header, **changes})


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"schema": 99}, "has schema 99; this version reads up to"),
        ({"format": "other"}, "has format 'other'; expected 'pwm_gym.minari'"),
        ({"settings": {}}, "names no task in its settings"),
        ({"settings": {"task": "FetchPush"}}, r"has actions of shape (7,); task 'FetchPush' expects (4,)"),
        ({"combinations": []}, "episode 0: assets 0; expected -1 to -1"),
        ({"layout": {"entities": [], "supports": []}}, "expected 0 entities"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(folder, minari_folder, tmp_path, changes, told):
    export_minari(folder, ID)
    rewrite_header(minari_folder, **changes)
    assert told in refused(ID, tmp_path / "back")
    assert not (tmp_path / "back").exists() and not list(tmp_path.glob(".back*"))


def test_a_truncated_side_file_is_named(folder, minari_folder, tmp_path):
    export_minari(folder, ID)
    path = minari_folder / ID / "data" / SIDE_FILE
    path.write_bytes(path.read_bytes()[:-100])
    assert "is truncated or foreign; export again" in refused(ID, tmp_path / "back")


def test_a_truncated_data_file_is_named(folder, minari_folder, tmp_path):
    export_minari(folder, ID)
    path = minari_folder / ID / "data" / "main_data.hdf5"
    path.write_bytes(path.read_bytes()[:1000])
    assert f"Minari cannot read '{ID}'" in refused(ID, tmp_path / "back")


def test_an_export_that_fails_leaves_nothing(folder, minari_folder, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pwm_gym.data.minari_format.save_arrays", full)
    with pytest.raises(OSError, match="No space left"):
        export_minari(folder, ID)
    assert not (minari_folder / ID).exists()
