import importlib
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.costs import cost_info, get_cost, get_grasp
from pwm_gym.dynamics import rollout
from pwm_gym.errors import PwmGymError
from pwm_gym.planning.adapters import CostModel, FlatModel
from pwm_gym.planning.adapters.pytorch_mppi import pytorch_mppi
from pwm_gym.scene import batch_state
from pwm_gym.tasks import get_task
from pwm_gym.wrappers import EntityPoses

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


def test_torchrl_rolls_a_batch_with_gradients(flat, scene):
    pytest.importorskip("torchrl")
    from tensordict import TensorDict

    from pwm_gym.planning.adapters.torchrl import TorchRLEnv

    world = TorchRLEnv(flat, flat.vector(scene))
    with torch.no_grad():
        rolled = world.rollout(2, tensordict=TensorDict({}, [3]))
    assert rolled["state"].shape == (3, 2, flat.size) and rolled["next", "reward"].shape == (3, 2, 1)
    torch.testing.assert_close(rolled["state"][:, 0], flat.vector(scene).expand(3, -1))
    step = world.reset(TensorDict({}, [3]))
    action = torch.zeros(3, 7, requires_grad=True)
    world.step(step.set("action", action))["next", "reward"].sum().backward()
    assert action.grad.abs().sum(-1).min() > 0


def test_torchrl_takes_the_gymnasium_environment(env):
    pytest.importorskip("torchrl")
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs

    world = GymWrapper(EntityPoses(env))
    check_env_specs(world)
    assert world.rollout(2)["next", "observation"].shape == (2, 51)


@pytest.fixture
def states(flat, scene):
    """The scene's vector for each of 3 samples in each of 2 environments (2, 3, X)."""
    return flat.vector(scene).expand(2, 3, -1)


def test_a_cost_model_sums_costs_along_each_candidate(flat, scene, states, random_actions):
    candidates = torch.as_tensor(random_actions(0, 2, 3, 4, 7))
    model = CostModel(flat)
    with torch.no_grad():
        costs = model.get_cost({"state": states, "goal": np.zeros(2)}, candidates)
        vector, expected = flat.vector(scene)[None], torch.zeros(1)
        for action in candidates[1, 2]:
            vector = flat.step(vector, action[None])
            expected = expected + flat.cost(vector, action[None])
        assert costs.shape == (2, 3)
        torch.testing.assert_close(costs[1, 2:], expected)
        torch.testing.assert_close(model.criterion({"state": states}, candidates), costs)
        blocks = candidates.reshape(2, 3, 2, 14)  # two actions a block
        torch.testing.assert_close(model.get_cost({"state": states}, blocks), costs)
        history = torch.stack([torch.zeros_like(states), states], 2).numpy()
        torch.testing.assert_close(model.get_cost({"state": history}, candidates), costs)
        beyond = model.get_cost({"state": states}, 9.0 * torch.ones(2, 3, 1, 7))
        torch.testing.assert_close(beyond, model.get_cost({"state": states}, torch.ones(2, 3, 1, 7)))


def test_a_cost_model_has_gradients(flat, states):
    candidates = torch.zeros(2, 3, 2, 7, requires_grad=True)
    CostModel(flat).get_cost({"state": states}, candidates).sum().backward()
    assert candidates.grad[..., :3].abs().amax((0, 1, 3)).min() > 0  # of each step


def test_a_cost_model_names_what_does_not_fit(flat, states):
    with pytest.raises(PwmGymError, match="unknown entry of info_dict 'stat'; known: state. Did you mean 'state'"):
        CostModel(flat, "stat").get_cost({"state": states}, torch.zeros(2, 3, 1, 7))
    with pytest.raises(PwmGymError, match=r"candidates have shape \(2, 3, 1, 8\); expected \(E, S, H, K x 7\)"):
        CostModel(flat).get_cost({"state": states}, torch.zeros(2, 3, 1, 8))
    with pytest.raises(PwmGymError, match=r"info_dict\['state'\] has shape \(2, 3, 5\); expected \(2, 3, "):
        CostModel(flat).get_cost({"state": states[..., :5]}, torch.zeros(2, 3, 1, 7))


def test_stable_worldmodels_solver_descends_it(env, scene):
    try:
        importlib.import_module("torchvision")
    except (ImportError, RuntimeError) as error:  # one that is not built for this torch is a RuntimeError
        pytest.skip(f"stable-worldmodel needs a torchvision that fits torch: {error}")
    solvers = pytest.importorskip("stable_worldmodel.solver", exc_type=ImportError)
    from stable_worldmodel.policy import PlanConfig

    flat = FlatModel(env.unwrapped.model, scene, high)
    solver = solvers.CEMSolver(CostModel(flat), num_samples=32, n_steps=2, topk=4)
    solver.configure(action_space=gym.spaces.Box(-1.0, 1.0, (1, 7)), n_envs=1, config=PlanConfig(3, 1))
    planned = solver.solve({"state": flat.vector(scene)[None]})["actions"].clamp(-1, 1)  # (1, 3, 7)
    with torch.no_grad():
        vector = flat.vector(scene)
        for action in planned[0]:
            vector = flat.step(vector, action)
    assert flat.state(vector).entity("hand")[0, :, 2].mean() > batch_state([scene]).entity("hand")[0, :, 2].mean()


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
