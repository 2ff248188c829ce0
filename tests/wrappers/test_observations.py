"""FlattenPoints and EntityPoses."""

import warnings
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from pwm_gym.wrappers import EntityPoses, FlattenPoints

KEYS = ("points", "velocity", "previous_velocity", "goal")


@pytest.fixture(params=[FlattenPoints, EntityPoses])
def wrapper(request):
    return request.param


@pytest.fixture(params=["model", "sim"])
def either(request):
    return request.getfixturevalue("env" if request.param == "model" else "sim")


def test_check_env_is_clean(wrapper):
    env = wrapper(gym.make("pwm/PickCube-v0"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*different from the unwrapped version.*")
        check_env(env)


def test_the_spec_rebuilds_it(wrapper):
    env = wrapper(gym.make("pwm/PickCube-v0"))
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert type(again) is wrapper
    np.testing.assert_array_equal(again.reset(seed=0)[0], env.reset(seed=0)[0])


def test_vectors_lie_in_the_space(wrapper, either, random_actions):
    env = wrapper(either)
    vectors = [env.reset(seed=0)[0], *(env.step(a)[0] for a in random_actions(0, 5, 7))]
    for vector in vectors:
        assert vector in env.observation_space
        assert vector.dtype == np.float32 and vector.shape == env.observation_space.shape
    assert np.isfinite(env.observation_space.low).all() and np.isfinite(env.observation_space.high).all()
    assert not any(np.shares_memory(a, b) for a, b in pairwise(vectors))


def test_flatten_points_keeps_every_value(env, random_actions):
    flat = FlattenPoints(env)
    flat.reset(seed=0)
    action = random_actions(0, 7)
    vector = flat.step(action)[0]
    env.reset(seed=0)
    observation = env.step(action)[0]
    assert vector.shape == (9 * 1200 + 3,)
    start = 0
    for name in KEYS:
        size = observation[name].size
        np.testing.assert_array_equal(vector[start : start + size].reshape(observation[name].shape), observation[name])
        start += size
    assert start == vector.size


def test_entity_poses_hold_position_rotation_velocity_goal(either, random_actions):
    env = EntityPoses(either)
    env.reset(seed=0)
    for action in random_actions(0, 3, 7):
        before = env.unwrapped.state.poses()[0].numpy()
        vector = env.step(action)[0]
    base = env.unwrapped
    now = base.state.poses()[0].numpy()
    assert vector.shape == (12 * len(base.entities) + 3,)
    for i, e in enumerate(base.entities):
        position, rotation, velocity = np.split(vector[12 * i : 12 * (i + 1)], [3, 9])
        np.testing.assert_allclose(position, now[i, :3, 3], atol=1e-6, err_msg=e.name)
        np.testing.assert_allclose(rotation.reshape(3, 2), now[i, :3, :2], atol=1e-6)
        np.testing.assert_allclose(velocity, now[i, :3, 3] - before[i, :3, 3], atol=1e-6)
    np.testing.assert_array_equal(vector[-3:], base.goal[0].numpy())
    assert np.abs(velocity).max() < 2 and np.abs(vector[9:12]).max() > 1e-4


def test_twins_have_equal_wrapped_spaces(wrapper, env, sim):
    assert wrapper(env).observation_space == wrapper(sim).observation_space


def test_twins_wrapped_observations_agree(wrapper, env, sim):
    true, _ = wrapper(sim).reset(seed=0)
    predicted, _ = wrapper(env).reset(options={"scene": sim.unwrapped.scene()})
    np.testing.assert_allclose(predicted, true, atol=1e-5)
