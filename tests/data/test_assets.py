"""Data sets of synthetic scenes: assets that differ between episodes, files of version 0.1, damage."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from pwm_gym.data import Batch, Episode, Windows, load_split
from pwm_gym.data.augment import reframe
from pwm_gym.data.episodes import read_shard, write_shard
from pwm_gym.data.windows import mixed
from pwm_gym.errors import DatasetError, UnknownNameError
from pwm_gym.scene import RigidState, Support

FIELDS = ("clouds", "frames", "actions", "following", "joints", "following_joints")


def assert_same_episodes(a, b):
    assert len(a) == len(b)
    for x, y in zip(a, b, strict=True):
        for field in fields(Episode):
            np.testing.assert_array_equal(getattr(x, field.name), getattr(y, field.name), field.name)


@pytest.fixture
def several(worlds, recorder):
    return recorder.several(worlds["cube"])


@pytest.mark.parametrize("name", ["drawer", "two arms", "pot", "bolted hand", "no arm"])
@pytest.mark.parametrize("goal", [0, 4])
def test_files_of_every_kind_of_scene_survive(worlds, recorder, tmp_path, name, goal):
    dataset = recorder.dataset(worlds[name], goal=goal)
    found = load_split(recorder.write(dataset, tmp_path), "train", "Test")
    assert (found.task, found.layout) == ("Test", dataset.layout)
    assert found.assets.keys() == dataset.assets.keys()
    assert_same_episodes(found.episodes, dataset.episodes)
    assert found.scene(found.episodes[1], 2).validate("Test", dataset.layout, goal).goal.shape == (goal,)


def test_every_episode_has_the_clouds_of_its_assets(several, recorder, tmp_path):
    found = load_split(recorder.write(several, tmp_path), "train")
    assert len(found.combinations) == 3 and found.clouds.shape == (3, found.layout.points, 3)
    cube = found.layout["cube"].slice
    for k, episode in enumerate(found.episodes):
        expected = several.assets[f"cube {k % 3}"]
        np.testing.assert_array_equal(found.cloud(episode)[cube], expected)
        scene = found.scene(episode)
        np.testing.assert_array_equal(scene.clouds[cube], expected)
        assert scene.assets == episode.assets and scene.assets[3] == f"cube {k % 3}"


def test_windows_draw_the_clouds_of_their_episode(several):
    windows = Windows(several)
    first = np.cumsum([0, *(len(e) + 1 for e in several.episodes)])[:-1]
    batch = windows.at(torch.as_tensor(first) + 1, 2, torch.Generator())
    cube = several.layout["cube"].slice
    for k in range(6):
        np.testing.assert_array_equal(batch.clouds[k, cube], several.assets[f"cube {k % 3}"])
        np.testing.assert_array_equal(batch.actions[k], several.episodes[k].actions[1:3])
    every = windows.transitions()
    lengths = [len(e) for e in several.episodes]
    expected = np.repeat([1.0 + k % 3 for k in range(6)], lengths)
    size = every.clouds[:, cube].amax((1, 2)) / several.assets["cube 0"].max()
    np.testing.assert_allclose(size, expected, rtol=1e-5)
    chunks = list(windows.chunks(7))
    assert torch.equal(torch.cat([c.clouds for c in chunks]), every.clouds)
    assert sum(len(c.actions) for c in chunks) == sum(lengths)


def test_training_draws_orders_of_a_clouds_points(several):
    once, anew = Windows(several), Windows(several, orders=4)
    stored = once.sample(torch.Generator().manual_seed(0), 64, 2)
    drawn = anew.sample(torch.Generator().manual_seed(0), 64, 2)
    assert torch.equal(stored.frames, drawn.frames) and torch.equal(stored.actions, drawn.actions)
    same = (drawn.clouds == stored.clouds).flatten(1).all(1)
    assert 0.05 < same.float().mean() < 0.6  # the stored order is one of them
    for entity in several.layout:  # the same points, whatever their order
        told, found = stored.clouds[:, entity.slice], drawn.clouds[:, entity.slice]
        gaps = torch.cdist(told, found, compute_mode="donot_use_mm_for_euclid_dist")
        assert gaps.amin(1).max() == 0.0 and gaps.amin(2).max() == 0.0
    assert torch.equal(anew.transitions().clouds, once.transitions().clouds)
    with pytest.raises(DatasetError, match="orders=0; expected at least 1"):
        Windows(several, orders=0)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda d: {"assets": {**d.assets, "cube 1": d.assets["cube 1"][:-1]}}, DatasetError,
         r"asset 'cube 1' has points \(15, 3\); expected \(16, 3\)"),
        (lambda d: {"assets": {k: v for k, v in d.assets.items() if k != "cube 2"}}, UnknownNameError,
         "unknown asset 'cube 2'; known: .*Did you mean"),
        (lambda d: {"episodes": (replace(d.episodes[0], assets=("hand",)),)}, DatasetError,
         r"names assets \('hand',\); expected 4, one an entity"),
        (lambda d: {"episodes": (replace(d.episodes[0], poses=d.episodes[0].poses[:, :3]),)}, DatasetError,
         "an episode has 3 entities; expected 4"),
        (lambda d: {"episodes": (replace(d.episodes[0], assets=()),)}, UnknownNameError, "unknown asset 'cube'"),
    ],
)  # fmt: skip
def test_assets_that_do_not_fit_are_refused(several, change, error, message):
    with pytest.raises(error, match=message):
        replace(several, **change(several))


def test_files_of_assets_that_do_not_fit_are_named(several, recorder, tmp_path):
    folder = recorder.write(several, tmp_path)
    path = folder / "asset-cube 1.npz"
    content = path.read_bytes()
    path.write_bytes(content[:50])
    with pytest.raises(DatasetError, match=r"asset-cube 1\.npz is truncated or no asset's file"):
        load_split(folder, "train")
    np.savez(path, dots=np.zeros(3))
    with pytest.raises(DatasetError, match=r"asset-cube 1\.npz is no asset's file \(it lacks points\)"):
        load_split(folder, "train")
    np.savez(path, points=np.full((16, 3), np.nan))
    with pytest.raises(DatasetError, match=r"asset-cube 1\.npz: points holds 48 values that are not finite"):
        load_split(folder, "train")
    path.unlink()
    with pytest.raises(UnknownNameError, match="unknown asset 'cube 1'"):
        load_split(folder, "train")


@pytest.mark.parametrize("name", ["poses", "joints", "actions", "rewards", "goal"])
def test_values_that_are_not_finite_are_neither_written_nor_read(several, recorder, tmp_path, name):
    bad = getattr(several.episodes[1], name).copy()
    bad.flat[2] = np.nan
    episodes = (several.episodes[0], replace(several.episodes[1], **{name: bad}))
    message = rf"train-.*\.npz: {name} holds 1 values that are not finite"
    with pytest.raises(DatasetError, match=message):
        recorder.write(replace(several, episodes=episodes), tmp_path / "new")
    assert not list((tmp_path / "new").glob("train-*"))
    (path,) = recorder.write(several, tmp_path / "old").glob("train-*")
    with np.load(path) as file:
        arrays = dict(file)
    arrays[name] = arrays[name].copy()
    arrays[name].flat[2] = np.inf
    np.savez(path, **arrays)
    with pytest.raises(DatasetError, match=message):
        load_split(tmp_path / "old", "train")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": 3}, r"has schema 3; this version reads up to 2"),
        ({"task": "Other"}, r"holds episodes of 'Other'; expected 'Test'"),
        ({"task": None}, r"header of .*Expected `str`, got `null`"),
        ({"assets": [["hand"]]}, r"names assets of 1 episodes; expected 6"),
        ({"assets": 3}, r"header of .*Expected `array`, got `int`"),
    ],
)
def test_a_shards_header_that_does_not_fit_is_refused(several, recorder, tmp_path, change, message):
    (path,) = recorder.write(several, tmp_path).glob("train-*")
    with np.load(path) as file:
        arrays = dict(file)
    header = {**json.loads(str(arrays.pop("header"))), **change}
    np.savez(path, header=np.array(json.dumps(header)), **arrays)
    with pytest.raises(DatasetError, match=message):
        load_split(tmp_path, "train")


def test_a_header_with_a_layout_that_does_not_fit_is_one_clear_error(several, recorder, tmp_path):
    for layout, message in ((3, "Expected `object`"), ({"entities": [3]}, r"\$\.entities\[0\]")):
        folder = recorder.write(several, tmp_path, layout=layout)
        with pytest.raises(DatasetError, match=rf"dataset\.json: layout: .*{message}"):
            load_split(folder, "train")


# Version 0.1


@pytest.fixture
def old_folder(worlds, recorder, tmp_path):
    """A data set in the files of version 0.1."""
    dataset = recorder.dataset(worlds["cube"])

    def entity(e):
        j = e.joint
        slider = {"parent": j.parent, "origin": j.origin, "axis": j.axis, "upper": j.upper} if j.moves else None
        return {"name": e.name, "start": e.start, "stop": e.stop, "effector": e.driven, "slider": slider}

    clouds = np.concatenate(list(dataset.assets.values()))
    header = {
        "format": "pwm_gym.dataset",
        "schema": 1,
        "settings": {"task": "PickCube", "practice": 0.5, "offset": 0},
        "layout": [entity(e) for e in dataset.layout],
        "kinds": ["expert", "randomised", "practice", "on_policy"],
        "clouds": clouds.tolist(),
    }
    (tmp_path / "dataset.json").write_text(json.dumps(header))
    arrays = {}
    for name in ("poses", "joints", "actions", "rewards", "success", "grasped"):
        arrays[name] = np.concatenate([getattr(e, name) for e in dataset.episodes])
    for name in ("goal", "kind", "seed", "switch"):
        arrays[name] = np.stack([getattr(e, name) for e in dataset.episodes])
    shard = {"format": "pwm_gym.episodes", "schema": 1, "task": "PickCube"}
    lengths = np.array([len(e) for e in dataset.episodes])
    np.savez(tmp_path / "train-expert-00000.npz", header=np.array(json.dumps(shard)), lengths=lengths, **arrays)
    return tmp_path, dataset


def test_data_sets_of_version_0_1_load(old_folder):
    folder, dataset = old_folder
    found = load_split(folder, "train", "PickCube")
    assert found.layout == replace(dataset.layout, supports=(Support.ground(),))
    assert found.assets.keys() == dataset.assets.keys()
    for name, points in dataset.assets.items():
        np.testing.assert_allclose(found.assets[name], points, rtol=1e-6)
    assert_same_episodes(found.episodes, dataset.episodes)
    a, b = (Windows(d).sample(torch.Generator().manual_seed(0), 8, 2) for d in (found, dataset))
    for name in FIELDS:
        torch.testing.assert_close(getattr(a, name), getattr(b, name))


def test_clouds_of_version_0_1_that_do_not_fit_are_refused(old_folder):
    folder, _ = old_folder
    path = folder / "dataset.json"
    header = json.loads(path.read_text())
    path.write_text(json.dumps({**header, "clouds": header["clouds"][:-1]}))
    with pytest.raises(DatasetError, match=r"has clouds of shape \(63, 3\); expected \(64, 3\)"):
        load_split(folder, "train")
    path.write_text(json.dumps({**header, "clouds": [*header["clouds"][:-1], [1.0]]}))
    with pytest.raises(DatasetError, match=r"clouds"):
        load_split(folder, "train")


# Several data sets


def test_mixed_windows_are_of_one_layout_each_and_of_all(worlds, recorder):
    sources = [Windows(recorder.dataset(worlds[name])) for name in ("cube", "drawer", "lid")]
    assert mixed(sources[:1]) is sources[0]
    both = mixed(sources)
    seen = []
    for seed in range(30):
        batch = both.sample(torch.Generator().manual_seed(seed), 3, 2)
        again = both.sample(torch.Generator().manual_seed(seed), 3, 2)
        assert isinstance(batch, Batch)
        assert batch.frames.shape == (3, 3, len(batch.layout), 4, 4) and batch.clouds.shape[1] == batch.layout.points
        assert all(torch.equal(getattr(batch, n), getattr(again, n)) for n in FIELDS)
        seen.append(batch.layout)
    counts = [seen.count(s.layout) for s in sources]
    assert sum(counts) == 30 and min(counts) >= 4


def test_axes_of_objects_that_something_hangs_on_are_left_alone(worlds, recorder):
    """A handle's place is told in its pot's frame."""
    windows = Windows(recorder.dataset(worlds["pot"]))
    before = windows.sample(torch.Generator().manual_seed(0), 20, 2)
    after = reframe(before, torch.Generator().manual_seed(1))
    turned = (after.frames - before.frames).abs().amax((0, 1, 3, 4)) > 0.1
    assert [n for n, t in zip(before.layout.names, turned, strict=True) if t] == ["cube"]
    now = [RigidState(b.layout, b.clouds, b.frames).points() for b in (before, after)]
    torch.testing.assert_close(now[1], now[0], atol=1e-6, rtol=0)


def test_articulated_motion_is_an_event(worlds, recorder):
    """A drawer that slides on its own counts as an object that moves."""
    world = worlds["drawer"].only("hand", "left_gripper", "right_gripper", "cabinet", "drawer")
    dataset = recorder.dataset(world, episodes=1, steps=30)
    episode = dataset.episodes[0]
    poses = np.repeat(episode.poses[:1], len(episode.poses), 0)
    poses[21:, 4, 0] -= 0.005  # in the step after frame 20
    windows = Windows(replace(dataset, episodes=(replace(episode, poses=poses),)), boost=50.0)
    batch = windows.sample(torch.Generator().manual_seed(0), 200, 1)
    moved = (batch.following[:, 0] - batch.frames[:, 0])[:, 4, 0, 3].abs() > 1e-3
    assert 0.5 < moved.float().mean() < 0.8  # 50 of 79, instead of 1 of 30


def test_several_objects_that_move_at_once_are_drawn_more_often(worlds, recorder):
    world = worlds["no arm"].only("cube", "ball")
    dataset = recorder.dataset(world, episodes=1, steps=30)
    episode = dataset.episodes[0]
    poses = np.repeat(episode.poses[:1], len(episode.poses), 0)
    poses[11:, 0, 0] += 0.005  # the cube alone in the step after frame 10
    poses[21:, :2, 0] += 0.005  # both in the one after frame 20
    windows = Windows(replace(dataset, episodes=(replace(episode, poses=poses),)), boost=10.0)
    batch = windows.sample(torch.Generator().manual_seed(0), 2000, 1)
    count = ((batch.following[:, 0] - batch.frames[:, 0])[:, :2, 0, 3].abs() > 1e-3).sum(1)
    shares = [float((count == n).float().mean()) for n in (1, 2)]
    assert shares == pytest.approx([10 / 138, 100 / 138], abs=0.03)  # 28 windows of weight 1


def test_shards_hold_episodes_with_and_without_assets(several, tmp_path):
    path = tmp_path / "shard.npz"
    header = {"format": "pwm_gym.episodes", "schema": 2, "task": "Test"}
    plain = [replace(e, assets=()) for e in several.episodes]
    write_shard(path, plain, header)
    assert_same_episodes(read_shard(path), plain)
