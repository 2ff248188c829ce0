"""Agents learn inside the world model and inside its twin, are saved without pickles, and act on scenes."""

import json
import shutil
from contextlib import closing
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

import pwm_gym
from pwm_gym.agents import AgentConfig, load_agent, train, training
from pwm_gym.agents.config import ALGORITHMS
from pwm_gym.agents.worlds import SuccessIsBest, make_world
from pwm_gym.cli import main
from pwm_gym.data import load_split
from pwm_gym.dynamics import load_checkpoint, resolve
from pwm_gym.errors import CheckpointError, DatasetError, PwmGymError, UnknownNameError
from pwm_gym.learning import logging_to
from pwm_gym.policies import PolicyAgent
from pwm_gym.scene import batch_state
from pwm_gym.seeds import split_of
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
SMALL = AgentConfig(
    rollout=8, steps=512, num_envs=16, points=40, episode_steps=10, width=16, snapshot_every=256, threads=1
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A folder for each algorithm, and what its training told."""
    out = tmp_path_factory.mktemp("agents")
    return {a: (out / a, train("PickCube", out / a, replace(SMALL, algorithm=a), progress=False)) for a in ALGORITHMS}


class Corridor(gym.Env):
    """Action 1 succeeds at once; action 0 stays at a reward of 0.8 for ever."""

    observation_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        return np.zeros(1, np.float32), {}

    def step(self, action):
        won = bool(action)
        return np.zeros(1, np.float32), 1.0 if won else 0.8, won, False, {"success": won}


def test_success_is_worth_more_than_hovering():
    world = SuccessIsBest(DummyVecEnv([Corridor, Corridor]))
    world.reset()
    returns, discount, alive = np.zeros(2), 0.9, np.ones(2, bool)
    for step in range(200):
        _, rewards, dones, infos = world.step(np.array([0, 1]))
        returns += discount**step * rewards * alive
        alive &= ~dones
        assert infos[1]["is_success"] is True and "is_success" not in infos[0]
    assert returns[1] == 0.0 and returns[0] == pytest.approx(-0.2 / (1 - discount), rel=1e-3)
    unshifted = 0.8 / (1 - discount)
    assert unshifted > 1.0  # what hovering would have been worth, against success at once


def test_it_learns_and_tells_what_that_took(trained):
    for algorithm, (folder, took) in trained.items():
        assert took["steps"] >= 512 and took["seconds"] > 0
        assert took["model_data_steps"] == 218_491 and took["model_minutes"] > 1
        described = json.loads((folder / "config.json").read_text())
        assert described["algorithm"] == algorithm and described["task"] == "PickCube"
        assert list((folder / "tensorboard").glob("events.*"))
        first, *_ = sorted((folder / "snapshots").iterdir())
        assert _far(load_agent(first), load_agent(folder)) > 1e-5


def test_who_asks_is_told_the_curves(tmp_path):
    seen = []
    with logging_to(lambda folder, step, values: seen.append((folder, step, values))):
        train("PickCube", tmp_path, replace(SMALL, snapshot_every=0), progress=False)
    assert {folder for folder, *_ in seen} == {tmp_path}
    steps = [step for _, step, _ in seen]
    assert steps == sorted(steps) and 0 < steps[0] < steps[-1] <= SMALL.steps + 128
    assert all(np.isfinite(value) for _, _, values in seen for value in values.values() if isinstance(value, float))
    assert "train/value_loss" in seen[-1][2]
    before = len(seen)
    train("PickCube", tmp_path / "untold", replace(SMALL, steps=128, snapshot_every=0), progress=False)
    assert len(seen) == before
    with pytest.raises(PwmGymError, match="logger 3; expected a function"), logging_to(3):
        pass


def _far(one, other):
    """The greatest difference of two policies' actions."""
    seen = np.random.default_rng(0).uniform(-1, 1, (16, *one.policy.observation_space.shape)).astype(np.float32)
    acts = [each.policy.predict(seen, deterministic=True)[0] for each in (one, other)]
    return float(np.abs(acts[0] - acts[1]).max())


def test_scenes_are_drawn_once_a_run(monkeypatch, tmp_path):
    drawn = []

    def draw(task, count):
        drawn.append(count)
        bank = load_checkpoint(resolve("default", task.name)).bank(task.name)
        return replace(bank, **{k: getattr(bank, k)[:count] for k in ("poses", "goals", "combination", "joints")})

    monkeypatch.setattr(training, "simulated_bank", draw)
    config = replace(SMALL, scenes=2)
    for goes_on in (False, True):
        bank = training._scenes(TASK, config, tmp_path, goes_on)
    assert drawn == [2] and len(bank) == 2
    with closing(make_world(TASK, config, bank)) as world:
        goals = world.reset()[:, -3:]
    assert {tuple(goal) for goal in goals} == {tuple(goal) for goal in bank.goals}


def test_caution_takes_the_expected_error_off_the_rewards():
    rewards = []
    for caution in (0.0, 2.0):
        with closing(make_world(TASK, replace(SMALL, caution=caution))) as world:
            world.reset()
            rewards.append([world.step(np.full((16, 7), 0.3, np.float32))[1] for _ in range(5)])
    plain, careful = np.array(rewards)
    assert (careful < plain).all() and (plain - careful)[-1].mean() > (plain - careful)[0].mean()


def test_scenes_may_be_of_demonstrations(data_folder, tmp_path):
    config = replace(SMALL, scenes=30, demonstrations=str(data_folder), underway=1.0)
    bank = training._scenes(TASK, config, tmp_path, goes_on=False)
    shown = load_split(data_folder, "train").of_kinds(("expert", "randomised"))
    first = {e.poses[0].tobytes() for e in shown.episodes}
    assert len(bank) == 30 and sum(poses.tobytes() in first for poses in bank.poses) < 5
    with closing(make_world(TASK, config, bank)) as world:
        world.reset()
        assert not np.any(world.step(np.zeros((16, 7), np.float32))[2])


def test_a_data_set_without_demonstrations_is_refused(data_folder, tmp_path):
    with pytest.raises(DatasetError, match=r"has no dataset\.json"):
        train("PickCube", tmp_path / "run", replace(SMALL, scenes=2, demonstrations=str(tmp_path)), progress=False)


def test_a_run_goes_on_where_it_was(trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained["ppo"][0], folder)
    before = load_agent(folder)
    same = train("PickCube", folder, replace(SMALL, algorithm="ppo"), progress=False)
    assert same["steps"] == trained["ppo"][1]["steps"] and _far(before, load_agent(folder)) == 0.0
    with pytest.raises(PwmGymError, match=r"holds a run of \{'steps': 512\}; expected \{'steps': 700\}"):
        train("PickCube", folder, replace(SMALL, algorithm="ppo", steps=700), progress=False)


def test_minutes_end_a_run_and_more_of_them_let_it_go_on(tmp_path):
    config = replace(SMALL, steps=1_000_000, minutes=0.02)
    took = train("PickCube", tmp_path, config, progress=False)
    assert 0 < took["steps"] < config.steps and took["seconds"] >= 1.2
    assert load_agent(tmp_path)
    assert train("PickCube", tmp_path, config, progress=False)["steps"] == took["steps"]
    longer = train("PickCube", tmp_path, replace(config, minutes=0.1), progress=False)
    assert took["steps"] < longer["steps"] < config.steps and longer["seconds"] >= 6.0


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_run_starts_from_another_ones_policy(trained, tmp_path, algorithm):
    """One step later it still acts much as that did; its own steps are counted from 0."""
    config = replace(SMALL, algorithm=algorithm, init=str(trained[algorithm][0]), steps=16, learning_rate=1e-9)
    took = train("PickCube", tmp_path / "further", config, progress=False)
    assert 16 <= took["steps"] <= 256
    gap = _far(load_agent(tmp_path / "further"), load_agent(trained[algorithm][0]))
    assert gap < 1e-3
    fresh = train("PickCube", tmp_path / "fresh", replace(config, init=""), progress=False)
    assert fresh["steps"] == took["steps"]
    assert _far(load_agent(tmp_path / "fresh"), load_agent(trained[algorithm][0])) > 10 * gap + 1e-3


def test_another_kind_of_run_is_no_beginning(trained, tmp_path):
    folder = str(trained["ppo"][0])
    for change, message in (
        ({"init": str(tmp_path)}, "holds no run; expected a folder of pwm-gym train-agent"),
        ({"init": folder, "width": 32}, r"is a run of \{'width': 16\}; expected \{'width': 32\}"),
        ({"init": folder, "algorithm": "sac"}, r"is a run of \{'algorithm': 'ppo'\}; expected \{'algorithm': 'sac'\}"),
    ):
        with pytest.raises(CheckpointError, match=message):
            train("PickCube", tmp_path / "other", replace(SMALL, **change), progress=False)  # which claims no folder
    broken = shutil.copytree(folder, tmp_path / "broken")
    (broken / "training-state.zip").write_bytes(b"PK")
    with pytest.raises(CheckpointError, match=r"training-state\.zip is missing, truncated or foreign"):
        train("PickCube", tmp_path / "other", replace(SMALL, init=str(broken)), progress=False)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_it_acts_where_a_planner_does(trained, scene, algorithm):
    policy = load_agent(trained[algorithm][0], "PickCube")
    agent = PolicyAgent(policy, "PickCube")
    action = agent.act(scene)
    assert action.shape == (7,) and np.abs(action).max() <= 1.0
    moved = replace(scene, goal=scene.goal + np.float32(0.1))
    both = agent.act([scene, moved])
    np.testing.assert_allclose(both[0], action, atol=1e-5)
    assert np.abs(both[0] - both[1]).max() > 1e-4


def test_points_are_read_and_their_order_within_an_entity_is_not(tmp_path, scene):
    train("PickCube", tmp_path, replace(SMALL, observation="points", steps=64), progress=False)
    policy = load_agent(tmp_path)
    state = batch_state([scene.coarsen(TASK.layout.resize(40))])
    goal = torch.as_tensor(scene.goal)[None]
    action = policy.act(state, goal)
    cube = state.layout["cube"].slice
    clouds = state.clouds.clone()
    clouds[:, cube] = clouds[:, cube].flip(1)
    torch.testing.assert_close(policy.act(replace(state, clouds=clouds), goal), action)
    clouds[:, cube] *= 3.0
    assert (policy.act(replace(state, clouds=clouds), goal) - action).abs().max() > 1e-5


def test_twins_are_learned_in_with_training_seeds_alone(monkeypatch, tmp_path):
    seeds = []
    reset = pwm_gym.envs.SimEnv.reset
    monkeypatch.setattr(
        pwm_gym.envs.SimEnv,
        "reset",
        lambda self, *, seed=None, options=None: seeds.append(seed) or reset(self, seed=seed),
    )
    config = replace(SMALL, world="sim", num_envs=1, episode_steps=3)
    world = make_world(TASK, config)
    observations = world.reset()
    for _ in range(4):
        observations, rewards, _, _ = world.step(np.zeros((1, 7), np.float32))
    assert observations.shape == (1, 51) and -1.0 <= rewards[0] <= 0.0
    world.close()
    assert len(seeds) >= 2 and {split_of(seed) for seed in seeds} == {"train"}


@pytest.mark.parametrize(
    ("settings", "kind", "message"),
    [
        ({"algorithm": "ppp"}, UnknownNameError, "unknown algorithm 'ppp'; known: ppo, sac. Did you mean 'ppo'"),
        ({"world": "real"}, UnknownNameError, "unknown world 'real'; known: model, sim"),
        ({"observation": "pose"}, UnknownNameError, "unknown observation 'pose'; known: points, poses"),
        ({"steps": 0}, PwmGymError, "steps=0; expected a whole number of at least 1"),
        ({"num_envs": -1}, PwmGymError, "num_envs=-1; expected a whole number of at least 0"),
        ({"discount": "a"}, PwmGymError, "discount='a'; expected a number between 0 and 1"),
        ({"underway": None}, PwmGymError, "underway=None; expected a share, 0 to 1"),
        ({"discount": 1.0}, PwmGymError, "discount=1.0; expected a number between 0 and 1"),
        ({"exploration": float("nan")}, PwmGymError, "exploration=nan; expected a number between 0 and 10"),
        ({"minutes": -1.0}, PwmGymError, r"minutes=-1\.0; expected a finite number of at least 0"),
        ({"minutes": float("nan")}, PwmGymError, "minutes=nan; expected a finite number"),
        ({"caution": -1.0}, PwmGymError, r"caution=-1\.0; expected a finite number of at least 0"),
        ({"caution": 1.0, "world": "sim"}, PwmGymError, r"caution=1\.0 in the sim; expected the model"),
        ({"underway": 1.5}, PwmGymError, r"underway=1\.5; expected a share, 0 to 1"),
        ({"demonstrations": "d"}, PwmGymError, "demonstrations='d' and scenes=0 in the model; expected some scenes"),
        ({"demonstrations": "d", "scenes": 2, "world": "sim"}, PwmGymError, "scenes=2 in the sim; expected some"),
    ],
)
def test_settings_that_cannot_be(settings, kind, message):
    with pytest.raises(kind, match=message):
        AgentConfig(**settings)


def test_folders_that_hold_no_such_policy(trained, tmp_path):
    with pytest.raises(CheckpointError, match="is not a checkpoint: it has no config.json"):
        load_agent(tmp_path)
    folder = tmp_path / "policy"
    shutil.copytree(trained["ppo"][0], folder, ignore=shutil.ignore_patterns("snapshots", "tensorboard"))
    with pytest.raises(CheckpointError, match="is a policy of PickCube; expected one of StackCube"):
        load_agent(folder, "StackCube")
    described = json.loads((folder / "config.json").read_text())
    for changes, message in (
        ({"action_size": 4}, "acts with 4 components; PickCube takes 7"),
        ({"algorithm": "dqn"}, "was trained by 'dqn'; expected ppo or sac"),
        ({"width": 32}, "does not fit its config.json"),
        ({"points": -3}, "points=-3; expected a whole number"),
    ):
        (folder / "config.json").write_text(json.dumps({**described, **changes}))
        with pytest.raises(CheckpointError, match=message):
            load_agent(folder)


def test_from_the_command_line(tmp_path, capsys, monkeypatch):
    drawn = []
    monkeypatch.setattr("pwm_gym.viewer.write_gif", lambda record, path: drawn.append((record.title, path)))
    settings = {"steps": 16, "num-envs": 2, "rollout": 4, "width": 8, "episode-steps": 4, "threads": 1}
    options = [word for name, value in settings.items() for word in (f"--agent.{name}", str(value))]
    where = ["--out", f"{tmp_path}/run", "--json", f"{tmp_path}/test.json", "--video", f"{tmp_path}/test.gif"]
    main(["train-agent", "--algo", "ppo", "--test-in", "model", "--episodes", "1", *options, *where])
    told = json.loads((tmp_path / "test.json").read_text())
    assert told["episodes"] == 1 and told["tested_in"] == "model" and told["training"]["steps"] >= 16
    assert drawn == [("PickCube: ppo in the model", tmp_path / "test.gif")]
    assert "environment steps in" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--algo", "dqn"], "unknown algo 'dqn'; known: cloning, ppo, sac"),
        (["--in", "real"], "unknown world 'real'; known: model, sim"),
        (["--episodes", "0", "--video", "x.gif"], "video=x.gif and episodes=0; expected an episode"),
        (["--algo", "ppo", "--test-in", "sims"], "unknown test_in 'sims'; known: model, sim. Did you mean 'sim'"),
    ],
)
def test_commands_that_cannot_be(options, message, tmp_path):
    with pytest.raises(SystemExit, match=message):
        main(["train-agent", *options, "--out", str(tmp_path)])
