"""Our own ManiSkill tasks as ManiSkill's users make them."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.sim.mugs import MUGS


def make(name):
    import pwm_gym.sim.maniskill.scenes  # noqa: F401  (registers the tasks)

    return gym.make(name, obs_mode="state_dict", render_backend="none", sim_backend="physx_cpu")


@pytest.fixture(scope="module")
def env():
    env = make("MugCleanup-v1")
    yield env
    env.close()


def test_it_is_registered_with_maniskill(env):
    from mani_skill.utils.registration import REGISTERED_ENVS

    assert REGISTERED_ENVS["MugCleanup-v1"].max_episode_steps == 400
    observation, info = env.reset(seed=0)
    assert observation["extra"]["mug_pose"].shape == (1, 7) and observation["extra"]["opening"].shape == (1,)
    assert not info.get("success", torch.tensor(False)).any()


def test_seeds_vary_the_mug_its_pose_and_the_cabinets(env):
    base, mugs, found = env.unwrapped, set(), []
    for seed in range(8):
        observation, _ = env.reset(seed=seed)
        mugs.add(base.mug_names)
        extra = observation["extra"]
        found.append(np.r_[extra["mug_pose"][0], extra["cabinet_pose"][0]])
        half = 0.5 * MUGS[base.mug_names[0]].height
        assert extra["mug_pose"][0, 2] == pytest.approx(half, abs=1e-3)  # it stands on the table
    spread = np.std(found, axis=0)
    assert len(mugs) > 2 and (spread[[0, 1, 7, 8]] > 5e-3).all() and spread[3] > 0.1


def test_the_reward_is_normalised(env):
    env.reset(seed=1)
    for _ in range(4):
        _, reward, terminated, _, info = env.step(env.action_space.sample())
        assert 0 < float(reward) < 1 and not terminated and not info["success"]


def test_coffee_starts_with_its_lid_open(request):
    env = make("Coffee-v1")
    request.addfinalizer(env.close)
    found = []
    for seed in range(4):
        extra = env.reset(seed=seed)[0]["extra"]
        assert np.degrees(float(extra["angle"][0])) == pytest.approx(105, abs=0.1)
        found.append(np.r_[extra["pod_pose"][0], extra["machine_pose"][0]])
    assert (np.std(found, axis=0)[[0, 1, 7, 8]] > 2e-3).all()
    _, reward, _, _, info = env.step(env.action_space.sample())
    assert 0 < float(reward) < 1 and not info["success"]
