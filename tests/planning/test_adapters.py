import sys

import numpy as np
import pytest
import torch

from pwm_gym.costs import cost_info, get_cost, get_grasp
from pwm_gym.dynamics import rollout
from pwm_gym.errors import PwmGymError
from pwm_gym.planning.adapters import FlatModel
from pwm_gym.planning.adapters.pytorch_mppi import pytorch_mppi
from pwm_gym.scene import batch_state
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
SIGMA = (0.3, 0.3, 0.3, 0.01, 0.01, 0.3, 0.5)


@pytest.fixture
def flat(env, scene):
    return FlatModel(env.unwrapped.model, scene)


def steer(planner, flat, scene, steps=4):
    """Height of the hand after some planned steps, with a cost that wants it high."""
    state = flat.vector(scene)
    for _ in range(steps):
        action = planner(state)
        assert action.shape == (7,) and action.abs().max() <= 1
        state = flat.step(state, action)
    return flat.state(state).entity("hand")[0, :, 2].mean()


def high(points, info):
    return -points["hand"].mean(-2)[..., 2]


def test_vectors_step_and_cost_as_states_do(flat, env, scene, random_actions):
    model, actions = env.unwrapped.model, torch.as_tensor(random_actions(0, 3, 4, 7))
    state = batch_state([scene] * 3)
    with torch.no_grad():
        expected = rollout(model, state, actions)
        goals = torch.as_tensor(scene.goal).expand(3, -1)
        points, info = cost_info(expected[:, -1], actions[:, -1], goals, get_grasp(TASK.grasp))
        costs = get_cost(TASK.plan_cost)(points, info)
        vectors = flat.vector(scene).expand(3, -1)
        for k in range(4):
            vectors = flat.step(vectors, actions[:, k])
        torch.testing.assert_close(flat.state(vectors).poses(), expected[:, -1].poses())
        torch.testing.assert_close(flat.cost(vectors, actions[:, -1]), costs)
        assert flat.cost(vectors.view(3, 1, -1), actions[:, -1:]).shape == (3, 1)


def test_pytorch_mppi_plans_with_the_model(env, scene):
    pytest.importorskip("pytorch_mppi")
    torch.manual_seed(0)
    flat = FlatModel(env.unwrapped.model, scene, high)
    planner = pytorch_mppi(flat, SIGMA, samples=32, horizon=4, temperature=0.01)
    with torch.no_grad():
        assert steer(planner.command, flat, scene) > batch_state([scene]).entity("hand")[0, :, 2].mean() + 0.02


def test_torchrl_plans_with_the_model(env, scene):
    pytest.importorskip("torchrl")
    from tensordict import TensorDict
    from torchrl.envs.utils import check_env_specs

    from pwm_gym.planning.adapters.torchrl import TorchRLEnv, torchrl_mppi

    torch.manual_seed(0)
    flat = FlatModel(env.unwrapped.model, scene, high)
    with torch.no_grad():
        world = TorchRLEnv(flat, flat.vector(scene))
        check_env_specs(world)
        planner = torchrl_mppi(world, samples=32, elites=4, horizon=4, scale=10.0)
        height = steer(lambda state: planner(TensorDict({"state": state}, []))["action"], flat, scene)
    assert height > batch_state([scene]).entity("hand")[0, :, 2].mean() + 0.02


def test_a_missing_library_names_the_extra(flat, monkeypatch):
    monkeypatch.setitem(sys.modules, "pytorch_mppi", None)
    with pytest.raises(PwmGymError, match=r"pwm-gym\[planners\]"):
        pytorch_mppi(flat, SIGMA)


def test_noise_that_cannot_be_is_named(flat):
    pytest.importorskip("pytorch_mppi")
    with pytest.raises(PwmGymError, match=r"sigma=\(0.3,\); expected 7 values more than 0"):
        pytorch_mppi(flat, (0.3,))
    with pytest.raises(PwmGymError, match="expected 7 values more than 0"):
        pytorch_mppi(flat, tuple(np.zeros(7)))
