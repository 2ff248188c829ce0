"""stable-baselines3: its checker, its algorithms, and the adapter of the native batch."""

import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import VecMonitor

from pwm_gym.errors import PwmGymError
from pwm_gym.wrappers import EntityPoses, FlattenPoints, SB3VecEnv


def small() -> dict:
    """Settings of a tiny policy; the algorithms write into them."""
    return {"policy_kwargs": {"net_arch": [16]}, "device": "cpu", "seed": 0}


def batch(num_envs=4, **kwargs):
    return gym.make_vec("pwm/PickCube-v0", num_envs=num_envs, autoreset_mode="SameStep", **kwargs)


@pytest.mark.parametrize("wrapper", [EntityPoses, FlattenPoints])
@pytest.mark.parametrize("name", ["pwm/PickCube-v0", "pwm/PickCubeSim-v0"])
def test_sb3s_checker_is_clean(name, wrapper):
    env = wrapper(gym.make(name))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
        check_env(env, warn=True)
    env.close()


def weights(model) -> torch.Tensor:
    return torch.nn.utils.parameters_to_vector(model.policy.parameters()).detach().clone()


@pytest.mark.parametrize(
    ("algorithm", "settings"),
    [
        (PPO, {"n_steps": 16, "batch_size": 32, "n_epochs": 2}),
        (SAC, {"learning_starts": 32, "buffer_size": 500, "batch_size": 16}),
    ],
    ids=["PPO", "SAC"],
)
def test_learns_a_few_hundred_steps_on_the_batch(algorithm, settings):
    env = VecMonitor(SB3VecEnv(batch(max_episode_steps=20)))
    model = algorithm("MlpPolicy", env, **small(), **settings)
    before = weights(model)
    model.learn(256)
    after = weights(model)
    assert model.num_timesteps >= 256
    assert torch.isfinite(after).all() and (after - before).abs().max() > 1e-5
    assert len(model.ep_info_buffer) >= 8 and {e["l"] for e in model.ep_info_buffer} == {20}
    actions, _ = model.predict(env.reset(), deterministic=True)
    assert actions.shape == (4, 7) and np.abs(actions).max() <= 1


def test_learns_on_the_single_env():
    model = PPO(
        "MlpPolicy",
        EntityPoses(gym.make("pwm/PickCube-v0")),
        n_steps=32,
        batch_size=16,
        n_epochs=1,
        **small(),
    )
    before = weights(model)
    model.learn(32)
    assert (weights(model) - before).abs().max() > 1e-5


def test_points_reach_a_dict_policy():
    env = SB3VecEnv(batch(2, points=40), observation="points")
    model = PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, n_epochs=1, **small())
    model.learn(16)
    assert model.num_timesteps == 16
    assert env.observation_space["points"].shape == (40, 3)


def test_observations_are_those_of_entity_poses(random_actions):
    env, single = SB3VecEnv(batch(2)), EntityPoses(gym.make("pwm/PickCube-v0"))
    assert env.observation_space == single.observation_space
    assert env.action_space == single.action_space
    env.seed(7)
    first = env.reset()
    assert first.dtype == np.float32
    np.testing.assert_allclose(first[1], single.reset(seed=8)[0], atol=1e-6)
    for actions in random_actions(0, 3, 2, 7):
        observation, reward, done, infos = env.step(actions)
        wanted, wanted_reward, *_ = single.step(actions[1])
        np.testing.assert_allclose(observation[1], wanted, atol=1e-5)
        assert reward[1] == pytest.approx(wanted_reward, abs=1e-4)
        assert reward.dtype == np.float32 and not done.any() and len(infos) == 2


@pytest.mark.parametrize("observation", ["poses", "points"])
def test_ends_carry_the_terminal_observation(observation, random_actions):
    actions = random_actions(0, 3, 2, 7)
    short, long = (SB3VecEnv(batch(2, max_episode_steps=n), observation) for n in (3, 50))
    for env in (short, long):
        env.seed(3)
        env.reset()
        for a in actions:
            got = env.step(a)
        if env is short:
            after, _, done, infos = got
    wanted = got[0]
    assert done.all() and not got[2].any()
    for i, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True and info["is_success"] is False
        if observation == "poses":
            np.testing.assert_array_equal(info["terminal_observation"], wanted[i])
            assert (after[i] != wanted[i]).any()
        else:
            for name, value in info["terminal_observation"].items():
                np.testing.assert_array_equal(value, wanted[name][i])
            assert not after["velocity"][i].any()
    assert all("terminal_observation" not in i for i in short.step(actions[0])[3])


def test_success_is_told(scene, replace_model):
    base = batch(2)
    env = SB3VecEnv(base)
    replace_model(base)
    env.reset()
    cube = scene.poses[0, 3, :3].astype(np.float32)
    far = (cube + np.array([0, 0, 0.2])).astype(np.float32)
    base.reset(options={"scene": [replace(scene, goal=g) for g in (cube, far)]})
    _, _, done, infos = env.step(np.zeros((2, 7), np.float32))
    assert list(done) == [True, False]
    assert infos[0]["is_success"] is True and infos[0]["TimeLimit.truncated"] is False
    np.testing.assert_array_equal(infos[0]["terminal_observation"][-3:], cube)
    assert infos[1] == {}


def test_pictures_and_attributes():
    env = SB3VecEnv(batch(2, render_mode="rgb_array"))
    env.reset()
    pictures = env.get_images()
    assert len(pictures) == 2 and all(p.dtype == np.uint8 for p in pictures)
    assert env.render_mode == "rgb_array" and env.get_attr("render_mode") == ["rgb_array"] * 2
    assert env.get_attr("num_envs", 0) == [2]
    assert env.env_is_wrapped(gym.Wrapper) == [False, False]
    env.close()


def test_what_it_takes():
    with pytest.raises(PwmGymError, match=r"autoreset_mode is .*NEXT_STEP; expected AutoresetMode\.SAME_STEP"):
        SB3VecEnv(gym.make_vec("pwm/PickCube-v0", num_envs=2))
    with pytest.raises(PwmGymError, match="takes a ModelVectorEnv; got SyncVectorEnv"):
        SB3VecEnv(gym.make_vec("pwm/PickCube-v0", num_envs=1, vectorization_mode="sync"))
    with pytest.raises(PwmGymError, match=r"unknown observation 'point'; known: .*Did you mean 'points'\?"):
        SB3VecEnv(batch(1), observation="point")
