"""RecordRollout."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec

from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.wrappers import RecordRollout


def files(folder) -> list[str]:
    return sorted(p.name for p in folder.iterdir()) if folder.exists() else []


def test_a_file_holds_the_episode(tmp_path, random_actions):
    env = RecordRollout(gym.make("pwm/PickCube-v0", max_episode_steps=4), tmp_path)
    observations, rewards = [env.reset(seed=0)[0]], []
    actions = random_actions(0, 4, 7)
    for action in actions:
        observation, reward, *_ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    assert files(tmp_path) == ["episode-00000.npz"]  # the time limit ended it
    with np.load(tmp_path / "episode-00000.npz", allow_pickle=False) as file:
        data = dict(file)
    shapes = {k: v.shape for k, v in data.items()}
    assert shapes == {
        "poses": (5, 4, 7),
        "actions": (4, 7),
        "rewards": (4,),
        "success": (4,),
        "goal": (3,),
        "clouds": (1200, 3),
    }
    np.testing.assert_array_equal(data["actions"], actions)
    np.testing.assert_allclose(data["rewards"], rewards, atol=1e-6)
    np.testing.assert_array_equal(data["goal"], observations[0]["goal"])
    assert data["success"].dtype == bool
    frames = matrix_from_pose7(torch.as_tensor(data["poses"])).numpy()
    for frame, observation in zip(frames, observations, strict=True):
        for i, e in enumerate(env.unwrapped.entities):
            points = data["clouds"][e.slice] @ frame[i, :3, :3].T + frame[i, :3, 3]
            np.testing.assert_allclose(points, observation["points"][e.slice], atol=1e-5)


def test_reset_and_close_write_what_is_under_way(tmp_path, random_actions):
    env = RecordRollout(gym.make("pwm/PickCube-v0"), tmp_path / "new" / "folder")
    folder = tmp_path / "new" / "folder"
    env.reset(seed=0)
    env.reset(seed=1)
    assert files(folder) == []  # no step, no file
    env.step(random_actions(0, 7))
    env.reset(seed=2)
    assert files(folder) == ["episode-00000.npz"]
    for action in random_actions(1, 2, 7):
        env.step(action)
    env.close()
    assert files(folder) == ["episode-00000.npz", "episode-00001.npz"]
    env.close()
    assert len(files(folder)) == 2
    lengths = [len(np.load(folder / f)["actions"]) for f in files(folder)]
    assert lengths == [1, 2]


def test_the_env_is_not_changed(tmp_path, env, random_actions):
    recorded = RecordRollout(gym.make("pwm/PickCube-v0"), tmp_path)
    for e in (env, recorded):
        e.reset(seed=0)
    for action in random_actions(0, 3, 7):
        a, b = env.step(action), recorded.step(action)
        np.testing.assert_array_equal(a[0]["points"], b[0]["points"])
        assert a[1:] == b[1:]


def test_records_the_simulator(tmp_path, sim, random_actions):
    env = RecordRollout(sim, tmp_path)
    env.reset(seed=0)
    poses = [sim.unwrapped.simulator.poses()]
    for action in random_actions(0, 2, 7):
        env.step(action)
        poses.append(sim.unwrapped.simulator.poses())
    env.flush()
    data = np.load(tmp_path / "episode-00000.npz")
    np.testing.assert_allclose(data["poses"][..., :3], np.stack(poses)[..., :3], atol=1e-6)
    alignment = np.abs((data["poses"][..., 3:] * np.stack(poses)[..., 3:]).sum(-1))  # q and -q are one rotation
    assert alignment.min() == pytest.approx(1.0, abs=1e-6)


def test_a_lost_prediction_is_recorded_too(tmp_path, replace_model):
    env = RecordRollout(gym.make("pwm/PickCube-v0"), tmp_path)
    env.reset(seed=0)
    replace_model(env, lambda poses: poses * np.nan)
    *_, truncated, info = env.step(np.zeros(7, np.float32))
    assert truncated and info["reason"] == "left the bounds"
    assert files(tmp_path) == ["episode-00000.npz"]


def test_the_spec_rebuilds_it(tmp_path):
    env = RecordRollout(gym.make("pwm/PickCube-v0"), tmp_path)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert type(again) is RecordRollout and again.folder == tmp_path
