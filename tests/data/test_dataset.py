import json
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.data import Windows, load_split
from pwm_gym.errors import DatasetError, UnknownNameError
from pwm_gym.scene.se3 import matrix_from_pose7

HORIZON = 6


@pytest.fixture
def windows(train_split):
    return Windows(train_split)


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def frames_of(dataset):
    """True poses (F, E, 4, 4) of all episodes, and each frame's episode (F,)."""
    poses = torch.cat([torch.as_tensor(e.poses, dtype=torch.float64) for e in dataset.episodes])
    owner = np.repeat(np.arange(len(dataset.episodes)), [len(e) + 1 for e in dataset.episodes])
    return matrix_from_pose7(poses).float(), owner


def test_the_episodes_start_repeats_its_first_pose(train_split, windows):
    batch = windows.at(torch.tensor([0, 1, 2]), 1, torch.Generator())
    poses, _ = frames_of(train_split)
    torch.testing.assert_close(batch.frames[0], poses[[0, 0, 0]])
    torch.testing.assert_close(batch.frames[1], poses[[1, 0, 0]])
    torch.testing.assert_close(batch.frames[2], poses[[2, 1, 0]])


def test_a_later_episodes_start_knows_nothing_of_the_one_before(train_split, windows):
    first = len(train_split.episodes[0]) + 1
    poses, owner = frames_of(train_split)
    assert owner[first] == 1
    torch.testing.assert_close(windows.at(torch.tensor([first]), 1, torch.Generator()).frames[0], poses[[first] * 3])


@pytest.mark.parametrize("horizon", [1, HORIZON])
def test_windows_hold_one_episodes_consecutive_steps(train_split, windows, horizon):
    poses, owner = frames_of(train_split)
    frames = defaultdict(list)  # several of an arm that rests
    for i, p in enumerate(poses):
        frames[tuple(p[:, :3, 3].flatten().tolist())].append(i)
    actions = [e.actions for e in train_split.episodes]
    starts = np.r_[0, np.cumsum([len(e) + 1 for e in train_split.episodes])]
    batch = windows.sample(generator(), 400, horizon)
    for b in range(400):
        found = []
        for i in frames[tuple(batch.frames[b, 0, :, :3, 3].flatten().tolist())]:
            step, taken = i - starts[owner[i]], actions[owner[i]]
            if step + horizon <= len(taken):  # it never crosses an episode's end
                same = torch.allclose(batch.following[b], poses[i + 1 : i + 1 + horizon], rtol=0, atol=1e-6)
                found.append(same and np.array_equal(batch.actions[b], taken[step : step + horizon]))
        assert any(found)


def test_samples_are_a_pure_function_of_the_generators_seed(train_split, windows):
    windows.sample(generator(5), 8, 3)  # whatever was drawn before
    a, b = (w.sample(generator(1), 32, HORIZON) for w in (windows, Windows(train_split)))
    c = windows.sample(generator(2), 32, HORIZON)
    for name in ("frames", "actions", "following", "clouds"):
        assert torch.equal(getattr(a, name), getattr(b, name))
    assert not torch.equal(a.frames, c.frames)


def test_transitions_are_every_step_once(train_split, windows):
    every = windows.transitions()
    steps = sum(len(e) for e in train_split.episodes)
    assert len(windows) == len(every.actions) == steps
    expected = np.concatenate([e.actions for e in train_split.episodes])
    np.testing.assert_array_equal(every.actions[:, 0], expected)


def eventful(batch, dataset):
    """Bool (B,): the cube moves more than a millimetre in a step, and not with the hand."""
    poses = torch.cat([batch.frames[:, :1], batch.following], 1)[..., :3, 3]
    move = poses[:, 1:] - poses[:, :-1]
    cube, hand = (dataset.layout.index(n) for n in ("cube", "hand"))
    own, relative = move[:, :, cube].norm(dim=-1), (move[:, :, cube] - move[:, :, hand]).norm(dim=-1)
    return (torch.minimum(own, relative) > 1e-3).any(1)


def test_boost_raises_the_share_of_windows_with_an_event(train_split):
    shares = [
        float(eventful(Windows(train_split, boost).sample(generator(), 4000, HORIZON), train_split).float().mean())
        for boost in (1.0, 3.0)
    ]
    plain = shares[0]
    assert 0.01 < plain < 0.6
    assert shares[1] == pytest.approx(3 * plain / (1 + 2 * plain), abs=0.04)


def test_a_horizon_that_no_episode_has_is_refused(windows):
    with pytest.raises(DatasetError, match="no episode is 500 steps long"):
        windows.sample(generator(), 1, 500)


def test_of_kinds_keeps_only_these(train_split):
    practice = train_split.of_kinds(("practice",))
    rest = train_split.of_kinds(("expert", "randomised"))
    assert len(practice.episodes) == len(rest.episodes) == 4
    with pytest.raises(UnknownNameError, match=r"unknown kind of episode 'practise'.*Did you mean 'practice'"):
        train_split.of_kinds(("practise",))


def test_a_scene_of_an_episode_carries_its_velocities(train_split):
    episode = train_split.episodes[0]
    scene = train_split.scene(episode, 5)
    np.testing.assert_array_equal(scene.poses, episode.poses[[5, 4, 3]].astype(float))
    np.testing.assert_array_equal(scene.last_action, episode.actions[4])
    scene.validate("PickCube", train_split.layout, 3)
    start = train_split.scene(episode)
    np.testing.assert_array_equal(start.poses, episode.poses[[0, 0, 0]].astype(float))
    assert start.last_action is None


def test_what_is_no_data_set_is_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"it has no dataset\.json"):
        load_split(tmp_path, "train")
    header = {"format": "other", "schema": 1}
    (tmp_path / "dataset.json").write_text(json.dumps(header))
    with pytest.raises(DatasetError, match="missing required field `settings`"):
        load_split(tmp_path, "train")
    header |= {"settings": {}, "layout": []}
    (tmp_path / "dataset.json").write_text(json.dumps(header))
    with pytest.raises(DatasetError, match="format 'other'; expected 'pwm_gym.dataset'"):
        load_split(tmp_path, "train")
    (tmp_path / "dataset.json").write_text(json.dumps({**header, "format": "pwm_gym.dataset", "schema": 99}))
    with pytest.raises(DatasetError, match="has schema 99; this version reads up to 2"):
        load_split(tmp_path, "train")
    (tmp_path / "dataset.json").write_text(json.dumps({**header, "format": "pwm_gym.dataset"}))
    with pytest.raises(DatasetError, match="names no task in its settings"):
        load_split(tmp_path, "train")


def test_an_unknown_split_is_answered_with_the_nearest(data_folder):
    with pytest.raises(UnknownNameError, match=r"unknown split 'tests'.*Did you mean 'test'\?"):
        load_split(data_folder, "tests")


def test_a_split_without_episodes_says_so(data_folder, tmp_path):
    (tmp_path / "dataset.json").write_bytes((data_folder / "dataset.json").read_bytes())
    with pytest.raises(DatasetError, match="has no episodes of split 'train' yet"):
        load_split(tmp_path, "train")


def test_episodes_shorter_than_the_horizon_are_left_out(train_split):
    episode = train_split.episodes[0]
    short = replace(
        episode, poses=episode.poses[:5], actions=episode.actions[:4], rewards=episode.rewards[:4],
        success=episode.success[:4], grasped=episode.grasped[:4], joints=episode.joints[:5],
    )  # fmt: skip
    both = replace(train_split, episodes=(short, episode))
    batch = Windows(both).sample(generator(), 500, 10)
    assert len(torch.unique(batch.frames[:, 0, 0, :3, 3], dim=0)) == len(episode) - 9
