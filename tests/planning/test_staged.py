from contextlib import closing
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.costs import STAGES_LEFT, Stage, StagedCost, cost_info, get_grasp, terms
from pwm_gym.envs import ModelVectorEnv
from pwm_gym.evaluation import planning_table
from pwm_gym.planning import Agent, MPPIConfig, Run, execute
from pwm_gym.scene import batch_state

FEW = MPPIConfig(samples=32, elites=10, horizon=6)


def sideways(points, info):
    return terms.tool(points, info)[:, 1]


def there_and_back(start, way=0.04):
    """Move the tool to the left, then to where it began."""
    return StagedCost(
        "there_and_back",
        {},
        (
            Stage("left", {"right": (-100.0, sideways)}, lambda p, i: sideways(p, i) > start + way),
            Stage("back", {"left": (100.0, sideways)}, lambda p, i: sideways(p, i) < start),
        ),
        price=20.0,
    )


def tool_of(scene):
    points, _ = cost_info(batch_state([scene]), torch.zeros(1, 7), torch.zeros(1, 3), get_grasp("pick_cube"))
    return float(terms.tool(points, {})[0, 1])


@pytest.fixture(scope="module")
def model_env():
    with gym.make("pwm/PickCube-v0") as env:
        yield env.unwrapped


def test_plans_cross_from_one_stage_into_the_next(model_env):
    model_env.reset(seed=3)
    cost = there_and_back(tool_of(model_env.scene()), way=0.02)
    agent = Agent(model_env.model, config=FEW, cost=cost)
    agent.reset(0)
    told, left = [], []
    for _ in range(14):
        action = agent.act(model_env.scene())
        told.append(agent.stage[0])
        agent.advance(action)
        model_env.step(action)
        left.append(tool_of(model_env.scene()))
    assert list(dict.fromkeys(told)) == ["left", "back", "finished"]
    assert max(left) > left[0] and told.index("finished") < 13
    agent.reset(0)
    assert agent.stage == ()


def test_a_plans_costs_tell_stages_that_its_own_steps_reach(model_env):
    model_env.reset(seed=3)
    cost = there_and_back(tool_of(model_env.scene()), way=0.02)
    prices = replace(cost, stages=tuple(replace(stage, terms={}) for stage in cost.stages))
    agent = Agent(model_env.model, cost=prices)
    agent.look(model_env.scene())
    objective = agent.objective.begin(agent._present(), agent._goal, agent._present_stage())
    actions = torch.zeros(1, 2, 10, 7)
    actions[..., -1] = 1.0
    actions[0, 1, :, 1] = 0.5  # to the left
    still, moved = objective(actions)[0]
    assert still == 40.0 * 12  # ten steps, the last of which counts three times
    assert still - moved in [20.0 * (steps + 2) for steps in range(5, 10)]  # most steps are in the second stage
    finished = agent.objective.begin(agent._present(), agent._goal, torch.tensor([2]))(actions)
    assert finished.tolist() == [[0.0, 0.0]]


def test_a_runs_terms_follow_the_stages_of_its_episode(model_env, tmp_path):
    model_env.reset(seed=3)
    cost = there_and_back(tool_of(model_env.scene()), way=0.02)
    run = execute(model_env, Agent(model_env.model, config=FEW, cost=cost), seed=3, max_steps=10, chunk=5)
    left = run.terms[STAGES_LEFT]
    assert left[0] == 40.0 and set(np.unique(left)) <= {0.0, 20.0, 40.0} and (np.diff(left) <= 0).all()
    assert left[-1] < 40.0
    assert [cost.stage_names[int(2 - k / 20.0)] for k in left] == list(run.stages)
    run.save(tmp_path / "run.npz")
    assert Run.load(tmp_path / "run.npz").stages == run.stages
    table = planning_table([run])
    assert table["runs"][0]["stage"] == run.stages[-1]
    assert table["stages"] == {"left": 1, "back": int(run.stages[-1] == "finished")}
    assert planning_table([replace(run, settings={})])["stages"] == {}


def test_environments_tell_each_ones_stage_and_begin_anew(model_env):
    model_env.reset(seed=3)
    cost = there_and_back(tool_of(model_env.scene()), way=0.02)
    with closing(ModelVectorEnv(num_envs=2, cost=cost, autoreset_mode="Disabled")) as env:
        _, info = env.reset(seed=[3, 3])
        assert info["stage"].tolist() == ["left", "left"] and info["cost_terms"][STAGES_LEFT].tolist() == [40.0, 40.0]
        actions = np.zeros((2, 7), np.float32)
        actions[0, 1] = 1.0
        for _ in range(3):
            *_, info = env.step(actions)
        assert info["stage"].tolist() == ["back", "left"]
        _, info = env.reset(seed=[3, 3], options={"reset_mask": np.array([True, False])})
        assert info["stage"].tolist() == ["left", "left"]
