"""Twin: model and simulator side by side."""

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec

from pwm_gym.envs import CameraConfig
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import RigidState
from pwm_gym.wrappers import Twin, divergence


@pytest.fixture
def twin(env, sim):
    return Twin(env, sim)


def test_both_start_from_the_same_scene(twin, env, sim):
    observation, info = twin.reset(seed=5)
    np.testing.assert_allclose(observation["points"], sim.unwrapped.state.points()[0], atol=1e-5)
    apart = info["divergence"]
    assert apart["chamfer_l1"] < 1e-5 and apart["reward"] == 0
    assert list(apart["position"]) == list(apart["rotation"]) == [e.name for e in env.unwrapped.entities]
    assert max(apart["position"].values()) < 1e-5
    assert max(apart["rotation"].values()) < 0.1
    again, _ = sim.reset(seed=5)
    np.testing.assert_allclose(again["points"], observation["points"], atol=1e-5)


def test_a_step_moves_both(twin, env, sim, random_actions):
    twin.reset(seed=0)
    action = random_actions(0, 7)
    observation, reward, terminated, truncated, info = twin.step(action)
    true = sim.unwrapped.state
    np.testing.assert_array_equal(observation["points"], env.unwrapped.state.points()[0])
    np.testing.assert_array_equal(sim.unwrapped.scene().last_action, action)
    np.testing.assert_array_equal(env.unwrapped.scene().last_action, action)
    assert observation in twin.observation_space
    assert info["divergence"]["reward"] == pytest.approx(reward - info["twin"]["reward"])
    assert info["twin"]["terminated"] is False and info["twin"]["truncated"] is False
    assert "simulator_reward" in info["twin"] and "success" in info
    gap = env.unwrapped.state.poses()[0, 3, :3, 3] - true.poses()[0, 3, :3, 3]
    assert info["divergence"]["position"]["cube"] == pytest.approx(float(gap.norm()), abs=1e-6)
    assert not terminated and not truncated


def test_a_model_that_stands_still_is_left_behind(twin, env, replace_model):
    replace_model(env)
    twin.reset(seed=0)
    up = np.array([0, 0, 1, 0, 0, 0, 1], np.float32)
    gaps = [twin.step(up)[-1]["divergence"] for _ in range(5)]
    heights = [g["position"]["hand"] for g in gaps]
    assert all(a < b for a, b in pairwise(heights)) and heights[-1] > 0.03
    assert gaps[-1]["position"]["cube"] < 1e-3
    assert gaps[-1]["chamfer_l1"] > 0.01


def test_a_given_scene_starts_both(twin, sim, random_actions):
    twin.reset(seed=1)
    for action in random_actions(0, 3, 7):
        twin.step(action)
    scene = sim.unwrapped.scene()
    twin.reset(seed=2)
    observation, info = twin.reset(options={"scene": scene})
    np.testing.assert_allclose(sim.unwrapped.scene().poses, scene.poses, atol=1e-4)
    assert info["divergence"]["chamfer_l1"] < 1e-5
    assert np.abs(observation["velocity"]).max() > 1e-4


def test_divergence_measures_metres_and_degrees(sim):
    sim.reset(seed=0)
    true = sim.unwrapped.state
    frames = true.frames.clone()
    frames[:, 0, 3, :3, 3] += torch.tensor([0.0, 0.03, 0.04])
    half = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    frames[:, 0, 0, :3, :3] = half @ frames[:, 0, 0, :3, :3]
    apart = divergence(RigidState(true.layout, true.clouds, frames), true)
    assert apart["position"]["cube"] == pytest.approx(0.05, abs=1e-6)
    assert apart["rotation"]["hand"] == pytest.approx(90, abs=0.01)
    assert apart["position"]["hand"] == apart["position"]["left_gripper"] == 0
    assert apart["rotation"]["cube"] == pytest.approx(0, abs=0.1)


def test_closing_closes_both_and_twice():
    closed = []
    a, b = gym.make("pwm/PickCube-v0"), gym.make("pwm/PickCubeSim-v0")
    twin = Twin(a, b)
    simulator = b.unwrapped.simulator
    close = simulator.close
    simulator.close = lambda: closed.append(True) or close()
    twin.close()
    twin.close()
    assert closed


def test_wrong_twins(env, sim):
    with pytest.raises(PwmGymError, match="wraps a ModelEnv and a SimEnv; got SimEnv, ModelEnv"):
        Twin(sim, env)
    with pytest.raises(PwmGymError, match="twins differ: PickCube with 600 points, PickCube with 1200"):
        Twin(gym.make("pwm/PickCube-v0", points=600), sim)


@pytest.mark.parametrize("form", [lambda spec: spec, lambda spec: EnvSpec.from_json(spec.to_json())], ids=["", "json"])
def test_its_spec_makes_it_again(form):
    camera = CameraConfig(viewpoint="left", completer="hull")
    sim = gym.make("pwm/PickCubeSim-v0", observation="completed", points=600, camera=camera)
    twin = Twin(gym.make("pwm/PickCube-v0", points=600), sim)
    again = gym.make(form(twin.spec))
    assert isinstance(again, Twin)
    first, second = (t.reset(seed=300_000)[0]["points"] for t in (twin, again))
    np.testing.assert_array_equal(first, second)
    twin.close()
    again.close()


def test_a_twin_by_its_id(env):
    twin = Twin(env, "pwm/PickCubeSim-v0")
    assert twin.reset(seed=1)[1]["divergence"]["chamfer_l1"] < 1e-5
    twin.twin.close()
