"""Policies compared in both worlds: the measures by hand, the contestants, and a comparison from start to picture."""

import json
import shutil

import numpy as np
import pytest
import torch

from pwm_gym.agents import AgentConfig, train
from pwm_gym.agents.contestants import contestant
from pwm_gym.agents.ranking import _told, rank_contestants, rank_policies, succeeds_in_model
from pwm_gym.cli import main
from pwm_gym.dynamics import resolve
from pwm_gym.errors import CheckpointError, PwmGymError, UnknownNameError
from pwm_gym.evaluation import max_rank_violation, ranking_table
from pwm_gym.scene import batch_state
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")


def test_max_rank_violation_by_hand():
    real, told = np.array([0.1, 0.5, 0.9]), np.array([0.2, 0.8, 0.6])
    # The last two are swapped: each of them loses 0.4, the first nothing.
    assert max_rank_violation(simulator=real, model=told) == pytest.approx(0.8 / 3)
    assert max_rank_violation(simulator=real, model=real**3) == 0.0
    assert max_rank_violation(simulator=real, model=-real) == pytest.approx((0.8 + 0.4 + 0.8) / 3)
    # A tie in the model, where the simulator sees a difference, is a violation one way: the arguments matter.
    tied = np.array([0.5, 0.5, 0.9])
    assert max_rank_violation(simulator=real, model=tied) == pytest.approx(0.4 / 3)


def test_the_table_tells_rates_pairs_and_intervals():
    rng = np.random.default_rng(0)
    real = rng.random((4, 200)) < np.array([0.1, 0.4, 0.6, 0.95])[:, None]
    told = real ^ (rng.random(real.shape) < 0.05)
    table = ranking_table(list("abcd"), told, real)
    assert table["between_20_and_80"] == 2 and table["agreement"] == pytest.approx((told == real).mean())
    low, high = table["pearson"]["interval"]
    assert low <= table["pearson"]["value"] <= high and table["pearson"]["value"] > 0.98
    assert table["mmrv"]["value"] == 0.0 and table["spearman"]["value"] == pytest.approx(1.0)
    for k, row in enumerate(table["rows"]):
        assert row["both"] + row["model_alone"] == told[k].sum() and row["simulator"] == real[k].mean()
        assert row["both"] + row["model_alone"] + row["simulator_alone"] + row["neither"] == 200
    shuffled = ranking_table(list("abcd"), told[::-1], real)
    assert shuffled["pearson"]["value"] < -0.98 and shuffled["mmrv"]["value"] > 0.5
    flat = ranking_table(list("ab"), told[[0, 0]], real[[0, 1]])
    assert flat["pearson"] == {"value": None, "interval": None} == flat["spearman"]


@pytest.mark.parametrize(
    ("names", "shape", "other"),
    [("a", (1, 5), (1, 5)), ("ab", (2, 5), (2, 4)), ("ab", (3, 5), (3, 5)), ("ab", (2,), (2,))],
)
def test_matrices_that_do_not_fit(names, shape, other):
    with pytest.raises(PwmGymError, match="expected two policies or more"):
        ranking_table(list(names), np.zeros(shape, bool), np.zeros(other, bool))


def test_a_ranking_without_scenes():
    with pytest.raises(PwmGymError, match="no scene is left to rank by"):
        ranking_table(list("ab"), np.zeros((2, 0), bool), np.zeros((2, 0), bool))


@pytest.mark.parametrize("spec", ["random", "expert:0.5"])
def test_an_episode_has_its_own_randomness(spec, scene):
    policy, goal = contestant(spec, TASK), torch.as_tensor(scene.goal)[None]
    state = batch_state([scene, scene])
    policy.begin([3, 5])
    both = policy.act(state, goal.expand(2, -1))
    policy.begin([5])
    torch.testing.assert_close(policy.act(batch_state([scene]), goal)[0], both[1])
    assert (both[0] - both[1]).abs().max() > 1e-3 and both.abs().max() <= 1.0


def test_the_expert_succeeds_in_the_model_and_chance_does_not(env):
    scenes = []
    for seed in range(3):
        env.reset(seed=seed)
        scenes.append(env.unwrapped.scene())
    assert succeeds_in_model(contestant("expert:0", TASK), "PickCube", scenes).sum() >= 2
    assert not succeeds_in_model(contestant("random", TASK), "PickCube", scenes, max_steps=20).any()


def test_a_planner_acts_where_policies_do(scene):
    policy = contestant("mppi:8", TASK)
    policy.begin([0])
    actions = policy.act(batch_state([scene, scene]), torch.as_tensor(scene.goal)[None].expand(2, -1))
    assert actions.shape == (2, 7) and actions.abs().max() <= 1.0


@pytest.mark.parametrize(
    ("spec", "kind", "message"),
    [
        (
            "expart",
            UnknownNameError,
            "unknown policy 'expart'; expected a folder of train-agent, or one of random, expert",
        ),
        ("expert:-1", PwmGymError, "'expert:-1' names no policy; expected a number of at least 0 after the colon"),
        ("expert:nan", PwmGymError, "'expert:nan' names no policy"),
        ("mppi:8@nowhere", UnknownNameError, "unknown checkpoint 'nowhere'"),
        ("mppi:", PwmGymError, "'mppi:' names no policy; expected a number of at least 1"),
        ("random:3", PwmGymError, "random:3; expected random alone"),
    ],
)
def test_names_that_are_no_policy(spec, kind, message):
    with pytest.raises(kind, match=message):
        contestant(spec, TASK)


def test_a_planner_in_another_checkpoint(scene, tmp_path):
    copy = shutil.copytree(resolve("default", "PickCube"), tmp_path / "copy")
    state, goal = batch_state([scene]), torch.as_tensor(scene.goal)[None]
    actions = []
    for spec in ("mppi:8", f"mppi:8@{copy}"):
        policy = contestant(spec, TASK)
        policy.begin([0])
        actions.append(policy.act(state, goal))
    torch.testing.assert_close(*actions)  # the same weights
    assert _told("mppi:8", "PickCube") != _told(f"mppi:8@{copy}", "PickCube") != _told("mppi:9", "PickCube")


class Asks:
    """Asks for the same always."""

    def __init__(self, action):
        self.action = action

    def act(self, state, goal):
        return self.action


def test_policies_of_ones_own(env):
    up, down = (Asks(np.full((1, 7), value, np.float32)) for value in (0.5, -0.5))
    table = rank_policies({"up": up, "down": down}, "PickCube", scenes=1, max_steps=2)
    assert table["success"] == {name: {"model": "0", "simulator": "0"} for name in ("up", "down")}


@pytest.mark.parametrize(
    ("policies", "scenes", "message"),
    [
        ({"one": Asks(None)}, 3, "policies 'one'; expected at least two"),
        ({}, 3, "policies none; expected at least two"),
        ({"one": Asks(None), "two": "random"}, 3, r"policy 'two' is a str; expected something with act\(state, goal\)"),
        ({"one": Asks(None), "two": Asks(None)}, "a", "scenes='a'; expected a whole number of at least 1"),
        ({k: Asks(np.zeros((1, 6))) for k in "ab"}, 1, r"actions of shape \(1, 6\); expected \(1, 7\)"),
    ],
)
def test_policies_that_cannot_be_ranked(policies, scenes, message):
    with pytest.raises(PwmGymError, match=message):
        rank_policies(policies, "PickCube", scenes=scenes, max_steps=2)


def test_folders_of_other_things(tmp_path):
    with pytest.raises(CheckpointError, match="config.json"):
        contestant(str(tmp_path), TASK)
    (tmp_path / "config.json").write_text(json.dumps({"format": "pwm_gym.policy", "task": "StackCube"}))
    with pytest.raises(CheckpointError, match="is a policy of StackCube; expected one of PickCube"):
        contestant(str(tmp_path), TASK)


def test_contestants_are_told_apart():
    for specs in (["random"], ["random", "random"], []):
        with pytest.raises(PwmGymError, match="expected at least two different ones"):
            rank_contestants(specs, "PickCube", None)


def test_from_policies_to_a_picture(tmp_path, capsys):
    small = AgentConfig(steps=16, num_envs=2, rollout=4, width=8, episode_steps=4, threads=1)
    train("PickCube", tmp_path / "policy", small, progress=False)
    command = [
        "rank",
        "random",
        str(tmp_path / "policy"),
        "--scenes",
        "2",
        "--max-steps",
        "3",
        "--out",
        f"{tmp_path}/out",
    ]
    main([*command, "--json", f"{tmp_path}/table.json", "--picture", f"{tmp_path}/table.png"])
    table = json.loads((tmp_path / "table.json").read_text())
    assert [row["name"] for row in table["rows"]] == ["random", str(tmp_path / "policy")]
    assert "training" not in table["rows"][0] and table["rows"][1]["training"]["steps"] == 16
    assert table["rows"][1]["training"]["seconds"] > 0.0
    assert table["success"]["random"] == {"model": "00", "simulator": "00"}
    assert table["scenes"] == table["floor"]["scenes"] == 2 and (tmp_path / "table.png").stat().st_size > 10_000
    told = capsys.readouterr().out
    assert "floor: pearson -, spearman -, mmrv 0.000" in told and "[2/2]" in told
    main(command)  # what is finished is kept
    assert "[1/" not in capsys.readouterr().out


def test_a_users_own_policies():
    class Rests:
        def act(self, state, goal):
            return torch.zeros(len(goal), 7)

    table = rank_policies({"rests": Rests(), "again": Rests()}, "PickCube", scenes=1, max_steps=2)
    assert table["agreement"] == 1.0 and [row["simulator"] for row in table["rows"]] == [0.0, 0.0]
