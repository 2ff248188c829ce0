import gymnasium as gym
import numpy as np
import pytest

from pwm_gym.completion import HullCompleter
from pwm_gym.envs import CameraConfig
from pwm_gym.errors import UnknownNameError
from pwm_gym.evaluation import chamfer
from pwm_gym.planning import Agent, MPPIConfig, Run, execute
from pwm_gym.scene import batch_state

SIM = "pwm/PickCubeSim-v0"


@pytest.fixture(scope="module")
def completed():
    env = gym.make(SIM, observation="completed", camera=CameraConfig(completer="hull", sensor="d455"))
    yield env
    env.close()


@pytest.fixture(scope="module")
def partial():
    env = gym.make(SIM, observation="partial")
    yield env
    env.close()


def clouds(env):
    base = env.unwrapped
    return [batch_state([base.scene(truth=t)]).points()[0].numpy() for t in (False, True)]


@pytest.mark.parametrize("name", ["completed", "partial"])
def test_what_is_shown_is_near_the_truth_but_not_it(name, request):
    env = request.getfixturevalue(name)
    for advance in (lambda: env.reset(seed=300_000), lambda: env.step(np.zeros(7, np.float32))):
        observation = advance()[0]
        shown, true = clouds(env)
        np.testing.assert_allclose(observation["points"], shown, atol=1e-6)
        assert observation in env.observation_space
        assert 0 < chamfer(shown, true) < 0.03
        cube = env.unwrapped.layout["cube"].slice
        assert np.linalg.norm(shown[cube].mean(0) - true[cube].mean(0)) < 0.02
    robot = env.unwrapped.layout["cube"].start
    if name == "completed":
        np.testing.assert_allclose(shown[:robot], true[:robot], atol=1e-4)
    else:
        assert chamfer(shown[:robot], true[:robot]) > 1e-3


def test_the_seed_decides_the_sensors_noise(completed):
    first = completed.reset(seed=300_000)[0]["points"]
    assert not np.array_equal(completed.reset(seed=300_001)[0]["points"], first)
    np.testing.assert_array_equal(completed.reset(seed=300_000)[0]["points"], first)


def test_the_reward_is_of_the_truth_and_info_tells_of_the_estimate(completed, sim):
    _, info = completed.reset(seed=300_000)
    _, expected = sim.reset(seed=300_000)
    assert info["cost_terms"] == expected["cost_terms"]
    assert set(info) - set(expected) == {"completion_error", "perception_seconds"}
    assert list(info["completion_error"]) == ["cube"] and 0 < info["perception_seconds"] < 5


def test_an_agent_plans_from_what_is_shown_and_the_record_holds_the_truth(completed, env, tmp_path):
    agent = Agent(env.unwrapped.model, "PickCube", MPPIConfig(samples=8, elites=2, horizon=3))
    run = execute(completed, agent, 300_000, max_steps=3)
    real = completed.unwrapped.scene(truth=True)
    np.testing.assert_array_equal(run.start.clouds, real.clouds)
    np.testing.assert_array_equal(run.poses[-1], real.poses[0])
    assert not np.array_equal(run.shown.clouds, run.start.clouds)
    run.save(tmp_path / "run.npz")
    again = Run.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(again.shown.clouds, run.shown.clouds)
    np.testing.assert_array_equal(again.shown.poses, run.shown.poses)


def test_an_unknown_checkpoint_of_completion_is_named():
    with pytest.raises(UnknownNameError, match="unknown checkpoint of completion 'nothing'"):
        gym.make(SIM, observation="completed", camera=CameraConfig(completer="nothing"))


def test_a_completer_of_ones_own():
    calls = []

    class Mine(HullCompleter):
        def __call__(self, partial, eye, points=2048):
            calls.append(points)
            return super().__call__(partial, eye, points)

    env = gym.make(SIM, observation="completed", points=400, camera=CameraConfig(completer=Mine()))
    env.reset(seed=300_000)
    env.step(np.zeros(7, np.float32))
    env.close()
    assert calls == [100]  # once an episode
