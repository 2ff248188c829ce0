"""Costs of the user's own: learned ones, ones that write into what they read, and what plans are judged by."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.commands.view import rolled_out, twin_record
from pwm_gym.errors import UnknownNameError
from pwm_gym.planning import Agent, MPPIConfig, execute
from pwm_gym.scene import Joint, Mimic

ID, SIM = "pwm/PickCube-v0", "pwm/PickCubeSim-v0"
PLAN = MPPIConfig(samples=16, elites=4, horizon=3)
ZERO = np.zeros(7, np.float32)


def height(points, info):
    return points["cube"].mean(-2)[..., 2]


@pytest.mark.parametrize("name", [ID, SIM])
def test_a_learned_cost(name):
    network = torch.nn.Linear(3, 1)
    env = gym.make(name, cost=lambda points, info: network(points["cube"].mean(-2))[..., 0])
    env.reset(seed=0)
    _, reward, *_ = env.step(ZERO)
    middle = env.unwrapped.state.entity("cube").mean(-2)
    assert reward == pytest.approx(-float(network(middle).detach()), abs=1e-6)
    env.close()


def test_planning_with_a_learned_cost(env, scene):
    network = torch.nn.Linear(3, 1)
    agent = Agent(env.unwrapped.model, "PickCube", PLAN, cost=lambda p, i: network(p["hand"].mean(-2))[..., 0])
    assert agent.plan(scene).shape == (3, 7) and network.weight.grad is None
    states = agent.advance(ZERO)
    assert agent.rewards(states, ZERO[None], agent.cost).shape == (1,)


@pytest.mark.parametrize("name", [ID, SIM])
def test_a_cost_that_writes_into_what_it_reads_changes_no_world(name):
    def vandal(points, info):
        for value in (info["goal"], info["action"], info["joints"], info["extra"]["goal_pos"]):
            if value is not None:
                value.fill_(0.3)
        info["grasped"].fill_(True)
        points["cube"][:] = info["goal"][:, None]  # as if it were there
        return 0.0 * height(points, info)

    envs = [gym.make(name, cost=cost) for cost in (vandal, height)]
    scene = None
    for env in envs:
        env.reset(seed=0)
        scene = scene or env.unwrapped.scene(truth=True)
        env.reset(options={"scene": scene})
    for _ in range(2):
        (spoilt, *_, told), (clean, *_, expected) = (env.step(ZERO) for env in envs)
        for key, value in clean.items():
            np.testing.assert_array_equal(spoilt[key], value)
        assert (told["success"], told["grasped"]) == (expected["success"], expected["grasped"]) == (False, False)
    a, b = (env.unwrapped.scene(truth=True) for env in envs)
    for field in ("poses", "goal", "joints", "last_action"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    for env in envs:
        env.close()


def test_predictions_are_judged_by_the_environments_own_cost(costs):
    def mine(points, info):
        return 5.0 + height(points, info)

    env = gym.make(ID, cost=mine)
    agent = Agent(env.unwrapped.model, "PickCube", PLAN)
    run = execute(env, agent, seed=0, max_steps=3)
    np.testing.assert_allclose(run.predicted_rewards, run.rewards, atol=1e-4)  # the world is the model itself
    assert run.predicted_rewards.max() < -5.0 and run.settings["reward_cost"] == "mine"
    with pytest.raises(UnknownNameError, match="unknown cost 'mine', of which the run's rewards are; register it"):
        rolled_out(run, agent)
    costs["mine"] = env.unwrapped.rules.cost
    again = rolled_out(run, agent)
    np.testing.assert_allclose(again.predicted_rewards, run.rewards, atol=1e-3)
    record = twin_record(again, "")
    np.testing.assert_allclose(record.predicted_reward, record.true_reward, atol=1e-3)


def test_whole_numbers_are_numbers():
    joint = Joint("prismatic", "a", (0, 0, 1, 1, 0, 0, 0), (0, 1, 0), 0, 1, Mimic("b", 2, 0))
    values = (*joint.origin, *joint.axis, joint.lower, joint.upper, joint.mimic.multiplier, joint.mimic.offset)
    assert all(type(v) is float for v in values)
