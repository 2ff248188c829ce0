"""Wrappers that change a living environment, or what a step is: costs, cameras, chunks, caution, fewer points."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec

from pwm_gym.costs import register_cost
from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.scene import Layout
from pwm_gym.wrappers import ActionChunk, Completed, CostFunction, Subsample, Twin, UncertaintyPenalty, vector


def height(points, info):
    """Height (B,) of the cube."""
    return points["cube"][..., 2].mean(-1)


@pytest.mark.parametrize("kind", ["env", "sim"])
def test_another_cost_rewards_the_next_step(kind, request, random_actions):
    env = request.getfixturevalue(kind)
    env.reset(seed=0)
    old = env.unwrapped.rules
    wrapped = CostFunction(env, height)
    try:
        _, reward, *_, info = wrapped.step(random_actions(0, 7))
        middle = float(env.unwrapped.state.entity("cube")[0, :, 2].mean())
        assert reward == pytest.approx(-middle, abs=1e-5) and list(info["cost_terms"]) == ["height"]
        assert env.unwrapped.rules.success is old.success
    finally:
        env.unwrapped.set_cost(None)
    assert list(env.unwrapped.rules.cost.terms) == list(old.cost.terms)


def test_a_staged_cost_begins_with_its_first_stage(env):
    env.reset(seed=0)
    wrapped = CostFunction(env, "coffee_plan")
    with pytest.raises(PwmGymError, match="no entity 'pod'"):
        wrapped.step(np.zeros(7, np.float32))
    with pytest.raises(UnknownNameError, match="nothing_known"):
        CostFunction(env, "nothing_known")


def test_the_batch_takes_another_cost_and_every_row_is_its_own(costs, random_actions):
    register_cost("of_height")(height)
    env = vector.CostFunction(gym.make_vec("pwm/PickCube-v0", num_envs=3), "of_height")
    env.reset(seed=0)
    _, reward, *_ = env.step(random_actions(0, 3, 7))
    heights = env.unwrapped.state.entity("cube")[..., 2].mean(-1)
    np.testing.assert_allclose(reward, -heights, atol=1e-5)


def test_specs_with_the_wrappers_make_them_again(random_actions):
    env = gym.make("pwm/PickCube-v0")
    for wrap in (
        lambda e: CostFunction(e, "pick_cube_plan"),
        lambda e: UncertaintyPenalty(e, weight=1.5, limit=0.2),
        lambda e: Subsample(e, 200),
        lambda e: ActionChunk(e, 3),
    ):
        env = wrap(env)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    actions = random_actions(0, 3, 7)
    found = []
    for one in (env, again):
        one.reset(seed=0)
        observation, reward, *_ = one.step(actions)
        found.append((observation["points"], reward))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1] and found[0][0].shape == (200, 3)


def test_a_camera_for_a_living_twin(sim):
    complete, _ = sim.reset(seed=3)
    wrapped = Completed(sim, camera={"viewpoint": "left", "completer": "hull"})
    try:
        observation, info = wrapped.reset(seed=3)
        assert "completion_error" in info and observation["points"].shape == complete["points"].shape
        gap = np.abs(observation["points"] - complete["points"]).max()
        assert 1e-4 < gap < 0.1  # it is an estimate, of the same scene
    finally:
        sim.unwrapped.set_observation("complete")
    again, info = sim.reset(seed=3)
    np.testing.assert_array_equal(again["points"], complete["points"])
    with pytest.raises(PwmGymError, match="Completed wraps a SimEnv; got ModelEnv"):
        Completed(gym.make("pwm/PickCube-v0"))


def test_a_chunk_is_its_actions_one_after_the_other(env, random_actions):
    actions = random_actions(0, 4, 7)
    env.reset(seed=0)
    steps = [env.step(action) for action in actions]
    chunked = ActionChunk(env, 4)
    chunked.reset(seed=0)
    observation, reward, terminated, truncated, info = chunked.step(actions)
    np.testing.assert_array_equal(observation["points"], steps[-1][0]["points"])
    assert info["chunk"]["rewards"] == [step[1] for step in steps] and reward == sum(info["chunk"]["rewards"])
    assert actions in chunked.action_space and not terminated and not truncated
    with pytest.raises(PwmGymError, match=r"a chunk of actions has shape \(3, 7\); expected \(4, 7\)"):
        chunked.step(actions[:3])


def test_a_chunk_ends_with_its_episode(random_actions):
    env = ActionChunk(gym.make("pwm/PickCube-v0", max_episode_steps=6), 4)
    env.reset(seed=0)
    actions = random_actions(0, 4, 7)
    assert len(env.step(actions)[-1]["chunk"]["rewards"]) == 4
    *_, terminated, truncated, info = env.step(actions)
    assert len(info["chunk"]["rewards"]) == 2 and truncated and not terminated


@pytest.mark.parametrize("length", [0, -1, 2.0, True, "3"])
def test_chunks_that_cannot_be(env, length):
    with pytest.raises(PwmGymError, match=r"length=.*; expected a whole number of at least 1"):
        ActionChunk(env, length)


def test_what_the_model_does_not_know_costs(env, random_actions):
    actions = random_actions(1, 8, 7)
    env.reset(seed=0)
    plain = [env.step(action) for action in actions]
    errors = [sum(step[-1]["expected_error"].values()) for step in plain]
    assert errors[-1] > errors[0] > 0.0
    limit = 0.5 * (errors[3] + errors[4])
    cautious = UncertaintyPenalty(env, weight=2.0, limit=limit)
    cautious.reset(seed=0)
    for action, step, error in zip(actions, plain, errors, strict=True):
        _, reward, terminated, truncated, info = cautious.step(action)
        assert reward == pytest.approx(step[1] - 2.0 * error, abs=1e-5) and not terminated
        assert (truncated, info["reason"]) == ((True, "unsure") if error > limit else (False, ""))
        if truncated:
            break
    assert error > limit


def test_the_batchs_penalty_is_of_the_step_that_ended_an_episode(random_actions):
    make = {"num_envs": 2, "autoreset_mode": "SameStep", "max_episode_steps": 3}
    plain, cautious = (gym.make_vec("pwm/PickCube-v0", **make) for _ in range(2))
    cautious = vector.UncertaintyPenalty(cautious, weight=4.0)
    for env in (plain, cautious):
        env.reset(seed=0)
    for k in range(4):
        actions = random_actions(k, 2, 7)
        _, before, *_, info = plain.step(actions)
        _, after, *_ = cautious.step(actions)
        told = info.get("final_info", info)
        error = sum(v for name, v in told["expected_error"].items() if not name.startswith("_"))
        assert (error > 0.0).all()
        np.testing.assert_allclose(before - after, 4.0 * error, rtol=1e-4, atol=1e-6)


def test_a_batch_ends_where_its_model_is_unsure_and_a_restart_costs_nothing(random_actions):
    actions = [random_actions(k, 2, 7) for k in range(6)]
    plain = gym.make_vec("pwm/PickCube-v0", num_envs=2)
    plain.reset(seed=0)
    steps = [plain.step(each) for each in actions]
    errors = [sum(v for k, v in step[-1]["expected_error"].items() if k[0] != "_") for step in steps]
    limit = float(np.sort(np.concatenate(errors[:4]))[-2:].mean())  # one of them is above it
    number, row = next((k, i) for k in range(4) for i in range(2) if errors[k][i] > limit)
    cautious = vector.UncertaintyPenalty(gym.make_vec("pwm/PickCube-v0", num_envs=2), weight=2.0, limit=limit)
    cautious.reset(seed=0)
    for k in range(number + 1):
        _, reward, terminated, truncated, info = cautious.step(actions[k])
        np.testing.assert_allclose(reward, steps[k][1] - 2.0 * errors[k], atol=1e-5)
        assert truncated.any() == (k == number) and not terminated.any()
    assert truncated[row] and not truncated[1 - row]
    assert info["reason"][row] == "unsure" and info["reason"][1 - row] == ""
    _, reward, _, truncated, info = cautious.step(actions[number + 1])
    assert reward[row] == 0.0 and not truncated[row] and info["reason"][row] == ""
    torched = gym.wrappers.vector.NumpyToTorch(cautious)
    assert {*torched.step(torch.as_tensor(actions[0]))[-1]["reason"].tolist()} <= {"", "unsure"}
    with pytest.raises(PwmGymError, match="limit=0.1 with autoreset_mode 'SameStep'; expected 'NextStep' or"):
        vector.UncertaintyPenalty(gym.make_vec("pwm/PickCube-v0", num_envs=2, autoreset_mode="SameStep"), 1.0, 0.1)


def test_a_chunk_of_an_unsure_batch_is_its_sum(random_actions):
    def cautious():
        return vector.UncertaintyPenalty(gym.make_vec("pwm/PickCube-v0", num_envs=2, max_episode_steps=2), weight=2.0)

    plain, chunked = cautious(), vector.ActionChunk(cautious(), 3)
    actions = np.stack([random_actions(k, 2, 7) for k in range(3)], 1)
    for env in (plain, chunked):
        env.reset(seed=0)
    rewards = [plain.step(actions[:, k])[1] for k in range(2)]
    _, reward, _, truncated, info = chunked.step(actions)
    assert truncated.all() and (info["chunk"]["steps"] == 2).all()
    np.testing.assert_allclose(reward, sum(rewards), atol=1e-5)


def test_a_simulator_knows_no_error_of_its_own_and_weights_are_checked(sim, env):
    wrapped = UncertaintyPenalty(sim, weight=1.0)
    wrapped.reset(seed=0)
    with pytest.raises(PwmGymError, match="no 'expected_error'"):
        wrapped.step(np.zeros(7, np.float32))
    for settings, message in (
        ({"weight": -1.0}, "weight=-1.0; expected"),
        ({"weight": float("nan")}, "weight=nan; expected"),
        ({"weight": "a"}, "weight='a'; expected a finite value"),
        ({"weight": 1.0, "limit": "a"}, "limit='a'; expected more than 0 metres"),
        ({"weight": 1.0, "limit": 0.0}, "limit=0.0; expected more than 0"),
    ):
        with pytest.raises(PwmGymError, match=message):
            UncertaintyPenalty(env, **settings)


def test_fewer_points_are_the_first_of_each_entitys(env, random_actions):
    full, _ = env.reset(seed=0)
    few = Subsample(env, 100)
    observation, _ = few.reset(seed=0)
    assert observation in few.observation_space and observation["velocity"].shape == (100, 3)
    for part, whole in zip(few.entities, env.unwrapped.entities, strict=True):
        expected = full["points"][whole.start : whole.start + part.points]
        np.testing.assert_array_equal(observation["points"][part.slice], expected)
    assert len(env.step(random_actions(0, 7))[0]["points"]) == 1200  # the world keeps its own
    with pytest.raises(PwmGymError, match="points=5000; expected a whole number from 4 to 1200"):
        Subsample(env, 5000)


def test_the_batchs_last_observations_have_fewer_points_too(random_actions):
    make = {"num_envs": 2, "autoreset_mode": "SameStep", "max_episode_steps": 1, "tensors": True}
    env = vector.Subsample(gym.make_vec("pwm/PickCube-v0", **make), 64)
    observation, _ = env.reset(seed=0)
    assert observation["points"].shape == (2, 64, 3) == env.observation_space["points"].shape
    observation, *_, info = env.step(torch.as_tensor(random_actions(0, 2, 7)))
    assert info["final_obs"]["velocity"].shape == observation["velocity"].shape == (2, 64, 3)
    assert Layout(env.entities).points == 64


def test_a_twin_is_synchronised_every_few_steps(env, sim, replace_model):
    replace_model(env)  # a model whose world stands still
    twin = Twin(env, sim, resync=3)
    twin.reset(seed=0)
    up = np.array([0, 0, 1, 0, 0, 0, 1], np.float32)
    gaps = [twin.step(up)[-1]["divergence"]["position"]["hand"] for _ in range(7)]
    assert gaps[0] < gaps[1] < gaps[2] and gaps[3] < gaps[2] and gaps[3] < gaps[4] < gaps[5] and gaps[6] < gaps[5]
    with pytest.raises(PwmGymError, match="resync=0; expected"):
        Twin(env, sim, resync=0)
