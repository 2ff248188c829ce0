"""The native batch's three autoreset modes, and masks."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from pwm_gym.errors import PwmGymError


def make(num_envs, **kwargs) -> gym.vector.VectorEnv:
    return gym.make_vec("pwm/PickCube-v0", num_envs=num_envs, **kwargs)


def rollout(env, seed, actions) -> list:
    return [env.reset(seed=seed), *(env.step(a) for a in actions)]


def test_next_step_ignores_the_action_and_gives_no_reward(random_actions):
    envs = [make(2, max_episode_steps=2) for _ in range(2)]
    actions = random_actions(0, 2, 2, 7)
    for env in envs:
        *_, truncated, info = rollout(env, 0, actions)[-1]
        assert truncated.all() and list(info["reason"]) == ["time limit"] * 2
    a, b = (env.step(x) for env, x in zip(envs, random_actions(1, 2, 2, 7), strict=True))
    assert data_equivalence(a, b, exact=True)
    observation, reward, terminated, truncated, _ = a
    assert not reward.any() and not terminated.any() and not truncated.any()
    assert not observation["velocity"].any()
    assert "final_obs" not in a[-1]
    after = [env.step(x) for env, x in zip(envs, random_actions(2, 2, 2, 7), strict=True)]
    assert (after[0][0]["points"] != after[1][0]["points"]).any()
    assert (after[0][1] != 0).all() and not after[0][3].any()
    assert envs[0].step(actions[0])[3].all()  # two steps after the restart


def test_same_step_gives_the_final_observation(random_actions):
    plain, same = make(2, max_episode_steps=50), make(2, max_episode_steps=2, autoreset_mode="SameStep")
    actions = random_actions(0, 2, 2, 7)
    expected, found = rollout(plain, 0, actions)[-1], rollout(same, 0, actions)[-1]
    observation, reward, _, truncated, info = found
    assert truncated.all() and info["_final_obs"].all() and info["_final_info"].all()
    assert data_equivalence(info["final_obs"], expected[0], exact=True)
    np.testing.assert_array_equal(reward, expected[1])
    assert list(info["final_info"]["reason"]) == ["time limit"] * 2
    np.testing.assert_array_equal(info["final_info"]["cost_terms"]["reaching"], expected[-1]["cost_terms"]["reaching"])
    assert not observation["velocity"].any() and info["final_obs"]["velocity"].any()
    assert list(info["reason"]) == ["", ""]
    assert "final_obs" not in same.step(actions[0])[-1]


def test_same_step_restarts_only_what_is_done(replace_model):
    env = make(2, autoreset_mode="SameStep")
    before = env.reset(seed=0)[0]

    def lose_the_second(poses):
        poses[1, :, :3, 3] += 5.0
        return poses

    replace_model(env, lose_the_second)
    observation, _, _, truncated, info = env.step(np.zeros((2, 7), np.float32))
    np.testing.assert_array_equal(truncated, [False, True])
    np.testing.assert_array_equal(info["_final_obs"], [False, True])
    np.testing.assert_allclose(observation["points"][0], before["points"][0], atol=1e-6)
    assert np.abs(observation["points"][1]).max() < 2.0
    assert info["final_info"]["reason"][1] == "left the bounds"


def test_disabled_waits_for_the_mask(random_actions):
    env = make(3, max_episode_steps=3, autoreset_mode="Disabled")
    actions = random_actions(0, 8, 3, 7)
    rollout(env, 0, actions[:2])
    started, _ = env.reset(options={"reset_mask": np.array([True, False, False])})
    kept = env.unwrapped.state.points().numpy()
    np.testing.assert_array_equal(started["points"], kept)
    assert not started["velocity"][0].any() and started["velocity"][1].any()
    last = env.step(actions[2])
    np.testing.assert_array_equal(last[3], [False, True, True])
    with pytest.raises(PwmGymError, match="done; reset them"):
        env.step(actions[3])
    again, _ = env.reset(options={"reset_mask": last[3]})
    np.testing.assert_array_equal(again["points"][0], last[0]["points"][0])
    np.testing.assert_array_equal(again["velocity"][0], last[0]["velocity"][0])
    assert not again["velocity"][1:].any()
    np.testing.assert_array_equal(env.step(actions[4])[3], [False] * 3)
    np.testing.assert_array_equal(env.step(actions[5])[3], [True, False, False])


def test_a_mask_seeds_only_what_it_restarts():
    env, other = make(2, autoreset_mode="Disabled"), make(2, autoreset_mode="Disabled")
    for e in (env, other):
        e.reset(seed=0)
    env.reset(seed=7, options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(env.reset()[0]["points"][1], other.reset()[0]["points"][1])


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.ones(2, bool), r"reset_mask is bool \(2,\); expected a boolean array \(3,\)"),
        (np.ones((3, 1), bool), r"reset_mask is bool \(3, 1\)"),
        (np.ones(3, np.int64), r"reset_mask is int64 \(3,\)"),
        ([True, False, True], "reset_mask is list"),
        (np.zeros(3, bool), "selects no environment"),
    ],
)
def test_bad_masks(mask, message):
    env = make(3, autoreset_mode="Disabled")
    env.reset(seed=0)
    with pytest.raises(PwmGymError, match=message):
        env.reset(options={"reset_mask": mask})


def test_the_first_reset_needs_every_environment():
    with pytest.raises(PwmGymError, match="first reset must reset every environment"):
        make(2, autoreset_mode="Disabled").reset(options={"reset_mask": np.array([True, False])})
