import importlib
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pwm_gym.agents.contestants import contestant_agent
from pwm_gym.collection import CollectConfig, collect
from pwm_gym.collection.shards import Shard
from pwm_gym.data import KINDS, Episode, load_split
from pwm_gym.data.dataset import SPLITS, read_header
from pwm_gym.data.episodes import read_shard
from pwm_gym.errors import DatasetError, PwmGymError, UnknownNameError
from pwm_gym.seeds import split_of
from pwm_gym.tasks import get_task


def assert_same(left, right, splits=SPLITS):
    """Two data sets hold the same arrays, bit for bit."""
    for split in splits:
        first, second = load_split(left, split), load_split(right, split)
        assert first.assets.keys() == second.assets.keys()
        for name, points in first.assets.items():
            np.testing.assert_array_equal(points, second.assets[name])
        assert first.layout == second.layout and len(first.episodes) == len(second.episodes)
        for x, y in zip(first.episodes, second.episodes, strict=True):
            for field in fields(Episode):
                a, b = getattr(x, field.name), getattr(y, field.name)
                np.testing.assert_array_equal(a, b, field.name)


@pytest.fixture
def copied(data_config, data_folder, tmp_path) -> CollectConfig:
    """Configuration of a copy of the small data set."""
    shutil.copytree(data_folder, tmp_path / "set")
    return replace(data_config, out=tmp_path / "set")


def test_kinds_and_counts_are_as_configured(data_folder):
    counts = {}
    for split in SPLITS:
        kinds = [KINDS[e.kind] for e in load_split(data_folder, split).episodes]
        counts[split] = (len(kinds), kinds.count("practice"))
    assert counts == {"train": (8, 4), "validation": (2, 1), "test": (2, 1)}


def test_splits_and_kinds_share_no_seed(data_folder):
    seeds = {split: [e.seed for e in load_split(data_folder, split).episodes] for split in SPLITS}
    every = [s for split in SPLITS for s in seeds[split]]
    assert len(set(every)) == len(every) == 12
    assert all(split_of(s) == split for split in SPLITS for s in seeds[split])


def test_episodes_are_whole(data_folder):
    for e in load_split(data_folder, "train").episodes:
        steps = len(e)
        assert steps >= 3
        assert e.poses.shape == (steps + 1, 4, 7) and e.joints.shape == (steps + 1, 2, 9)
        assert e.actions.shape == (steps, 7) and np.abs(e.actions).max() <= 1
        assert e.rewards.shape == e.success.shape == e.grasped.shape == (steps,)
        np.testing.assert_allclose(np.linalg.norm(e.poses[..., 3:], axis=-1), 1, atol=1e-5)
        assert e.success.any() or KINDS[e.kind] != "expert"


def assert_same_shards(whole, part, count):
    """A data set's ``count`` shards of training hold what a larger one's of the same names do, bit for bit."""
    paths = sorted(part.glob("train-*.npz"))
    assert len(paths) == count
    for path in paths:
        for x, y in zip(read_shard(path), read_shard(whole / path.name), strict=True):
            for field in fields(Episode):
                np.testing.assert_array_equal(getattr(x, field.name), getattr(y, field.name), field.name)


def test_two_workers_collect_what_one_does(data_config, data_folder, tmp_path):
    two = collect(replace(data_config, out=tmp_path / "two", episodes=4, held_out=1, workers=2), progress=False)
    assert_same_shards(data_folder, two, 2)
    assert len(load_split(two, "train").episodes) == 4


def test_a_killed_run_resumes_to_the_same_data(data_config, data_folder, tmp_path):
    out = tmp_path / "killed"
    options = f"--episodes 4 --held-out 1 --shard 2 --workers 1 --out {out}".split()
    run = subprocess.Popen(
        [sys.executable, "-m", "pwm_gym", "collect", *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    limit = time.monotonic() + 120
    while not list(out.glob("train-*.npz")) and run.poll() is None and time.monotonic() < limit:
        time.sleep(0.02)
    run.send_signal(signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    whole = {p: p.stat().st_mtime_ns for p in out.glob("train-*.npz")}
    assert len(whole) == 1  # killed in the middle
    collect(replace(data_config, out=out, episodes=4, held_out=1), progress=False)
    assert_same_shards(data_folder, out, 2)
    assert all(p.stat().st_mtime_ns == t for p, t in whole.items())  # what was there was kept


def test_a_process_that_dies_ends_the_run_and_the_next_one_goes_on(copied, data_folder, tmp_path, monkeypatch):
    (tmp_path / "deadly.py").write_text("import os\n\ndef die(job):\n    os._exit(1)\n")
    monkeypatch.syspath_prepend(tmp_path)  # of processes of their own, too
    for path in copied.out.glob("t*-practice-00000.npz"):
        path.unlink()
    with monkeypatch.context() as patch:
        patch.setattr(sys.modules[collect.__module__], "_collect_shard", importlib.import_module("deadly").die)
        with pytest.raises(PwmGymError, match="one of 2 processes died .* the same command goes on where it was"):
            collect(replace(copied, workers=2), progress=False)
    collect(copied, progress=False)
    assert_same(copied.out, data_folder)


def test_a_finished_data_set_is_left_alone(copied):
    before = {p: p.stat().st_mtime_ns for p in copied.out.iterdir()}
    collect(copied, progress=False)
    assert {p: p.stat().st_mtime_ns for p in copied.out.iterdir()} == before


def test_more_episodes_extend_a_data_set(copied, data_folder):
    collect(replace(copied, episodes=9, practice=0.5), progress=False)
    longer, before = load_split(copied.out, "train").episodes, load_split(data_folder, "train").episodes
    assert len(longer) == 9 and {e.seed for e in before} < {e.seed for e in longer}


@pytest.mark.parametrize("kept", [0.0, 0.5, 0.98])
def test_a_truncated_shard_is_named_when_read(copied, kept):
    path = copied.out / "train-practice-00001.npz"
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(DatasetError, match=r"train-practice-00001\.npz is truncated or not a shard"):
        load_split(copied.out, "train")


def test_collect_replaces_a_truncated_shard(copied, data_folder):
    path = copied.out / "test-practice-00000.npz"
    path.write_bytes(path.read_bytes()[:1000])
    collect(copied, progress=False)
    assert_same(copied.out, data_folder)


def test_a_garbled_shard_is_refused(copied):
    path = copied.out / "train-practice-00000.npz"
    content = bytearray(path.read_bytes())
    for i in range(len(content) // 4, len(content) // 2):
        content[i] ^= 0x5A
    path.write_bytes(content)
    with pytest.raises(DatasetError, match="train-practice-00000"):
        read_shard(path)


def test_a_foreign_shard_is_refused(copied):
    path = copied.out / "train-foreign-00000.npz"
    np.savez(path, header=np.array('{"format": "other", "schema": 2, "task": "PickCube"}'))
    with pytest.raises(DatasetError, match="has format 'other'; expected 'pwm_gym.episodes'"):
        load_split(copied.out, "train")


@pytest.mark.parametrize(
    "change", [{"practice": 0.25}, {"randomise": 0.5}, {"offset": 100}, {"shard": 3}], ids=lambda c: next(iter(c))
)
def test_other_settings_are_refused(copied, change):
    with pytest.raises(DatasetError, match=f"was collected with .*expected .*{next(iter(change))}"):
        collect(replace(copied, **change), progress=False)


def test_another_task_is_refused(data_folder):
    with pytest.raises(DatasetError, match="is a data set of task 'PickCube'; expected 'StackCube'"):
        load_split(data_folder, "train", "StackCube")
    shard = next(data_folder.glob("train-*.npz"))
    with pytest.raises(DatasetError, match="holds episodes of 'PickCube'; expected 'StackCube'"):
        read_shard(shard, "StackCube")


def test_an_unknown_task_is_refused(tmp_path):
    with pytest.raises(UnknownNameError, match="unknown task 'PickApple'"):
        collect(CollectConfig(task="PickApple", out=tmp_path), progress=False)
    assert not list(tmp_path.iterdir())


def test_objects_that_a_task_has_not_leave_no_data_set(tmp_path):
    with pytest.raises(PwmGymError, match="objects='unseen'; the objects of PickCube are always the same"):
        collect(CollectConfig(objects="unseen", out=tmp_path), progress=False)
    assert not list(tmp_path.iterdir())


def test_a_truncated_header_is_named(copied):
    path = copied.out / "dataset.json"
    path.write_text(path.read_text()[:100])
    with pytest.raises(DatasetError, match=r"dataset\.json is truncated or not valid"):
        collect(copied, progress=False)
    with pytest.raises(DatasetError, match=r"dataset\.json is truncated or not valid"):
        load_split(copied.out, "train")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": -3}, "episodes=-3; expected at least 1"),
        ({"held_out": 0}, "held_out=0; expected at least 1"),
        ({"workers": 0}, "workers=0; expected at least 1"),
        ({"shard": -1}, "shard=-1; expected at least 1"),
        ({"offset": -1}, "offset=-1; expected at least 0"),
        ({"practice": 1.5}, "practice=1.5; expected a share from 0 to 1"),
        ({"on_policy": -0.1}, "on_policy=-0.1; expected a share"),
        ({"randomise": float("nan")}, "randomise=nan; expected a share"),
        ({"mirrored": 1.5}, "mirrored=1.5; expected a share from 0 to 1"),
        ({"practice": 0.7, "on_policy": 0.7}, "expected at most 1 together"),
        ({"policy": "random"}, r"policy='random' and on_policy=0\.0; expected a share for it"),
        ({"mirrored": 0.5, "warp": 8}, "warp=8 and mirrored=0.5; expected one of them"),
    ],
)
def test_what_cannot_be_collected_is_refused(change, message):
    with pytest.raises(DatasetError, match=message):
        CollectConfig(**change)


def test_a_tasks_data_set_has_a_folder_of_its_own():
    assert CollectConfig(task="StackCube").folder == Path("data-sets/StackCube")
    assert CollectConfig(out=Path("mine")).folder == Path("mine")


@pytest.mark.parametrize("pattern", ["*", "dataset.json", "train-*.npz"])
def test_files_that_vanish_meanwhile_are_an_error(copied, monkeypatch, pattern):
    def vanish(*work):
        for path in copied.folder.glob(pattern):
            path.unlink()
        return iter(())

    monkeypatch.setattr(sys.modules[collect.__module__], "work_through", vanish)
    with pytest.raises(DatasetError, match=r"lost \d+ of \d+ files while it was collected"):
        collect(copied, progress=False)


class Waver:
    """An agent that moves this way and that, and checks what it is shown."""

    def __init__(self, model, task):
        assert (model, task) == ("model", "PickCube")
        self.steps = 0

    def reset(self, seed):
        self.steps = 0

    def act(self, scene):
        task = get_task(scene.task)
        scene.validate("PickCube", task.layout, 3)
        assert np.linalg.norm(scene.clouds[task.layout["cube"].slice], axis=1).max() < 0.04  # half its diagonal
        assert (scene.last_action is None) == (self.steps == 0)
        self.steps += 1
        return np.sin(self.steps + np.arange(7))


def test_a_planner_acts_in_episodes_of_its_own(data_config, tmp_path, monkeypatch):
    module = sys.modules[Shard.__module__]
    monkeypatch.setattr(module, "load_checkpoint", lambda folder: SimpleNamespace(model="model"))
    monkeypatch.setattr(module, "resolve", lambda checkpoint, task: checkpoint)
    monkeypatch.setattr(module, "Agent", Waver)
    config = replace(data_config, out=tmp_path / "set", episodes=2, held_out=1, practice=0.0, on_policy=1.0)
    for episode in load_split(collect(config, progress=False), "train").episodes:
        assert KINDS[episode.kind] == "on_policy" and len(episode) == 60
        np.testing.assert_allclose(episode.actions[3], np.sin(4 + np.arange(7)), rtol=1e-6)


def test_a_policy_acts_in_the_planners_place(data_config, tmp_path):
    """It is told when episodes begin; jitter goes to what it asks of the arm, and not to the gripper."""
    noisy = partial(contestant_agent, "expert:0.2")
    config = replace(
        data_config, out=tmp_path / "set", episodes=2, held_out=1, practice=0.0, on_policy=1.0, policy="expert:0.2"
    )
    folder = collect(config, progress=False, agent=noisy)
    assert read_header(folder).settings["policy"] == "expert:0.2"
    plain = load_split(folder, "train").episodes
    assert [KINDS[e.kind] for e in plain] == ["on_policy"] * 2
    again = load_split(collect(replace(config, out=tmp_path / "again"), progress=False, agent=noisy), "train").episodes
    np.testing.assert_array_equal(plain[1].actions, again[1].actions)
    jittered = replace(config, out=tmp_path / "jittered", jitter=0.5)
    moved = load_split(collect(jittered, progress=False, agent=noisy), "train").episodes
    assert np.abs(moved[0].actions[0] - plain[0].actions[0])[:6].max() > 0.01
    assert moved[0].actions[0, 6] == plain[0].actions[0, 6]


@pytest.mark.parametrize(("policy", "agent"), [("random", None), ("", lambda task: None)])
def test_a_policy_and_its_agent_go_together(data_config, tmp_path, policy, agent):
    config = replace(data_config, out=tmp_path / "set", on_policy=0.5, policy=policy)
    with pytest.raises(DatasetError, match="expected both or neither"):
        collect(config, progress=False, agent=agent)
    assert not config.folder.exists()


@pytest.mark.slow
def test_a_planners_own_runs_are_collected(data_config, tmp_path):
    config = replace(data_config, out=tmp_path / "set", episodes=1, held_out=1, practice=0.0, on_policy=1.0)
    (episode,) = load_split(collect(config, progress=False), "train").episodes
    assert KINDS[episode.kind] == "on_policy" and 3 <= len(episode) <= 60
    hand = episode.poses[:, 0, :3]
    cube = episode.poses[0, 3, :3]
    gap = np.linalg.norm(hand - cube, axis=1)
    assert gap.min() < 0.6 * gap[0]  # it plans to get at the cube


def test_a_data_set_without_a_folder_goes_to_its_tasks_own(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    folder = collect(CollectConfig(episodes=1, held_out=1, practice=1.0, workers=1), progress=False)
    assert folder == Path("data-sets/PickCube")
    assert load_split(folder, "train").assets.keys() == {"hand", "left_gripper", "right_gripper", "cube"}
