import json
import shutil
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.errors import CheckpointError, DatasetError, PwmGymError
from pwm_gym.evaluation import run_episodes
from pwm_gym.policies import CloningConfig, Policy, PolicyAgent, PolicyConfig, clone, load_policy
from pwm_gym.policies.cloning import _rows
from pwm_gym.scene import batch_state
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
SMALL = CloningConfig(phases=((1, 400, 128),), threads=1)


@pytest.fixture(scope="module")
def folder(data_folder, tmp_path_factory):
    return clone("PickCube", data_folder, tmp_path_factory.mktemp("policy"), SMALL, PolicyConfig(64, 2), progress=False)


def errors(policy, data):
    """Mean error of translations and gripper on a data set's demonstrations."""
    features, actions = _rows(policy, data.of_kinds(["expert", "randomised"]))
    with torch.no_grad():
        return (policy(features) - actions)[:, [0, 1, 2, 6]].abs().mean()


def test_a_policy_learns_what_demonstrations_did(folder, train_split):
    policy = load_policy(folder)
    fresh = Policy(TASK.layout, TASK.action_size, TASK.goal_size, policy.config)
    fresh.mean.copy_(policy.mean)
    fresh.std.copy_(policy.std)
    assert errors(policy, train_split) < 0.25 * errors(fresh, train_split)
    described = json.loads((folder / "config.json").read_text())
    assert described["demonstrations"] == 4 and described["training"]["metrics"]["action_error"] < 0.5


def test_an_action_is_the_same_from_a_scene_and_from_a_recorded_step(folder, train_split):
    policy = load_policy(folder)
    episode = next(e for e in train_split.episodes if e.kind == 0)
    data = replace(train_split, episodes=(episode,))
    features, _ = _rows(policy, data)
    step = 12
    scene = data.scene(episode, step)
    with torch.no_grad():
        expected = policy(features[step : step + 1])
    agent = PolicyAgent(policy, "PickCube")
    np.testing.assert_allclose(agent.act(scene), expected[0].numpy(), atol=1e-4)
    several = agent.act([scene, data.scene(episode, 0)])
    assert several.shape == (2, 7)
    np.testing.assert_allclose(several[0], expected[0].numpy(), atol=1e-4)


def test_it_acts_where_a_planner_does(folder):
    agent = PolicyAgent(load_policy(folder), "PickCube")
    env = gym.make("pwm/PickCube-v0")
    runs = run_episodes(env, agent, [3, 4], max_steps=6, progress=False)
    env.close()
    assert [run.steps for run in runs] == [6, 6]
    assert runs[0].settings["planner"] == "Policy" and runs[0].settings["model"] == "Still"
    assert np.ptp(runs[0].predicted[0] - runs[0].poses[0]) < 1e-4  # it takes the scene to stand still
    assert not np.allclose(runs[0].actions, runs[1].actions)


def test_steps_after_a_random_switch_are_not_learned(folder, train_split):
    policy = load_policy(folder)
    episode = replace(next(e for e in train_split.episodes if e.kind == 0), kind=1, switch=5)
    assert len(_rows(policy, replace(train_split, episodes=(episode,)))[0]) == 5


def test_fewer_demonstrations_are_evenly_chosen(data_folder, tmp_path):
    out = clone("PickCube", data_folder, tmp_path, replace(SMALL, phases=((1, 2, 16),)), episodes=2, progress=False)
    assert json.loads((out / "config.json").read_text())["demonstrations"] == 2


def test_bad_input_is_named(folder, data_folder, tmp_path):
    with pytest.raises(PwmGymError, match="episodes=-1; expected 0"):
        clone("PickCube", data_folder, tmp_path, SMALL, episodes=-1)
    with pytest.raises(DatasetError, match="episodes=5; .* has 4 demonstrations"):
        clone("PickCube", data_folder, tmp_path, SMALL, episodes=5)
    with pytest.raises(DatasetError, match="is not a data set"):
        clone("PickCube", tmp_path / "none", tmp_path, SMALL)
    practice = tmp_path / "practice"
    shutil.copytree(data_folder, practice)
    for path in practice.glob("train-demonstration-*"):
        path.unlink()
    with pytest.raises(DatasetError, match="has no demonstrations in its train split"):
        clone("PickCube", practice, tmp_path, SMALL)
    with pytest.raises(PwmGymError, match="width=0, depth=3; expected at least 1 each"):
        Policy(TASK.layout, 7, 3, PolicyConfig(width=0))
    with pytest.raises(CheckpointError, match="is not a checkpoint"):
        load_policy(tmp_path)
    damaged = tmp_path / "damaged"
    shutil.copytree(folder, damaged)
    (damaged / "model.safetensors").write_bytes(b"half")
    with pytest.raises(CheckpointError, match="truncated or not safetensors"):
        load_policy(damaged)


def test_scenes_of_other_entities_are_refused(folder, train_split):
    policy = load_policy(folder)
    state = batch_state([train_split.scene(train_split.episodes[0])])
    fewer = replace(policy.layout, entities=policy.layout.entities[:3])
    other = Policy(fewer, 7, 3, PolicyConfig(8, 1))
    with pytest.raises(PwmGymError, match="the policy is of scenes of"):
        other.act(state, torch.zeros(1, 3))
