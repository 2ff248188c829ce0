"""Environments of a batch that stand still while others go on, and chunks whose rows end at different actions."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.wrappers.vector import NumpyToTorch

from pwm_gym.errors import PwmGymError
from pwm_gym.wrappers import SB3VecEnv, vector

LENGTH, LIMIT = 4, 6
HELD = np.array([True, False])


@pytest.fixture
def make():
    made = []

    def make(mode="NextStep", task="PickCube", **settings):
        envs = gym.make_vec(f"pwm/{task}-v0", 2, autoreset_mode=mode, max_episode_steps=LIMIT, **settings)
        envs.reset(seed=0)
        made.append(envs)
        return envs

    yield make
    for envs in made:
        envs.close()


@pytest.fixture
def actions():
    return np.random.default_rng(3).uniform(-1, 1, (12, 2, 7)).astype(np.float32)


def chunk(actions, first=0):
    """Chunks (2, LENGTH, 7) of the actions from ``first`` on."""
    return actions[first : first + LENGTH].swapaxes(0, 1)


def late(envs):
    """The first environment's episode ends after two more actions, the other one's after six."""
    envs.unwrapped._elapsed[0] = LIMIT - 2


def test_what_is_held_stands_still_and_goes_on_later(make, actions):
    envs = make()
    base = envs.unwrapped
    envs.step(actions[0])
    before = base.scene(0)
    base.hold(HELD)
    for k in range(1, LIMIT + 2):
        _, reward, terminated, truncated, _ = envs.step(actions[k])
        assert reward[0] == 0.0 and not (terminated[0] or truncated[0])
        assert truncated[1] == (k == LIMIT - 1) and (reward[1] != 0.0) == (k != LIMIT)
    after = base.scene(0)
    np.testing.assert_array_equal(after.poses, before.poses)
    np.testing.assert_array_equal(after.last_action, actions[0][0])
    assert base.held.tolist() == HELD.tolist()
    base.hold(~HELD)
    ends = [envs.step(actions[k])[3][0] for k in range(LIMIT)]
    assert ends == [False] * (LIMIT - 2) + [True, False]  # the step before it was held counts alone


def test_what_succeeded_does_not_end_again_while_it_is_held(make, actions, monkeypatch):
    envs = make()
    base = envs.unwrapped
    judged = base.rules.judge
    monkeypatch.setattr(
        type(base.rules), "judge", lambda self, *args: replace(judged(*args), success=torch.ones(2, dtype=torch.bool))
    )
    base.hold(HELD)
    *_, terminated, _, _ = envs.step(actions[0])
    assert terminated.tolist() == [False, True]


def test_what_is_held_keeps_its_stage(make, actions, monkeypatch):
    envs = make(task="MugCleanup")
    base = envs.unwrapped
    judged = base.rules.judge

    def advance(self, state, action, goal, stage):
        found = judged(state, action, goal, stage)
        return replace(found, stage=stage + 1)

    monkeypatch.setattr(type(base.rules), "judge", advance)
    base.hold(HELD)
    info = envs.step(actions[0])[-1]
    assert info["stage"].tolist() == list(base.rules.stage_names[:2])
    info = envs.step(actions[1])[-1]
    assert info["stage"].tolist() == [base.rules.stage_names[0], base.rules.stage_names[2]]


def test_a_reset_lets_go_and_masks_are_checked(make, actions):
    envs = make("Disabled")
    base = envs.unwrapped
    base.hold(HELD)
    envs.reset(seed=1, options={"reset_mask": HELD})
    assert not base.held.any() and envs.step(actions[0])[1][0] != 0.0
    base.end(HELD)
    assert base.done.tolist() == HELD.tolist()
    with pytest.raises(PwmGymError, match="some environments are done"):
        envs.step(actions[1])
    with pytest.raises(PwmGymError, match=r"mask is bool \(3,\); expected a boolean array \(2,\)"):
        base.end(np.zeros(3, bool))
    with pytest.raises(PwmGymError, match="autoreset_mode is 'SameStep'; ending episodes needs 'NextStep'"):
        make("SameStep").unwrapped.end(HELD)


@pytest.mark.parametrize("tensors", [False, True])
def test_rows_of_a_chunk_end_at_different_actions(make, actions, tensors):
    plain, chunked = make(tensors=tensors), vector.ActionChunk(make(tensors=tensors), LENGTH)
    late(plain)
    late(chunked)
    steps = [plain.step(actions[k]) for k in range(LENGTH)]  # its first environment restarts after two
    observation, reward, terminated, truncated, info = chunked.step(chunk(actions))
    assert truncated.tolist() == [True, False] and not terminated.any()
    assert info["chunk"]["steps"].tolist() == [2, 4] and info["reason"].tolist() == ["time limit", ""]
    for row, last in ((0, 1), (1, 3)):
        np.testing.assert_array_equal(observation["points"][row], steps[last][0]["points"][row])
        np.testing.assert_array_equal(observation["goal"][row], steps[last][0]["goal"][row])
        assert float(reward[row]) == pytest.approx(sum(float(s[1][row]) for s in steps[: last + 1]), abs=1e-6)
        told = info["expected_error"]["hand"][row]
        assert told == steps[last][-1]["expected_error"]["hand"][row]
    assert chunked.unwrapped._elapsed.tolist() == [LIMIT, LENGTH] and not chunked.unwrapped.held.any()
    observation, reward, *_, info = chunked.step(chunk(actions, LENGTH))
    assert info["chunk"]["steps"].tolist() == [0, 2] and float(reward[0]) == 0.0
    np.testing.assert_array_equal(observation["points"][0], steps[2][0]["points"][0])  # the restart's


def test_rows_that_restart_at_once_within_a_chunk_wait(make, actions):
    plain, chunked = make("SameStep"), vector.ActionChunk(make("SameStep"), LENGTH)
    late(plain)
    late(chunked)
    steps = [plain.step(actions[k]) for k in range(LENGTH)]
    observation, _, _, truncated, info = chunked.step(chunk(actions))
    assert truncated.tolist() == [True, False] and info["_final_obs"].tolist() == [True, False]
    ended = steps[1][-1]
    np.testing.assert_array_equal(info["final_obs"]["points"][0], ended["final_obs"]["points"][0])
    assert info["final_info"]["reason"][0] == "time limit" and info["reason"].tolist() == ["", ""]
    np.testing.assert_array_equal(observation["points"][0], steps[1][0]["points"][0])
    np.testing.assert_array_equal(observation["points"][1], steps[3][0]["points"][1])
    assert chunked.unwrapped._elapsed.tolist() == [0, LENGTH]


def test_a_chunk_heeds_who_is_held_already(make, actions):
    envs = vector.ActionChunk(make(), LENGTH)
    base = envs.unwrapped
    before = base.scene(0)
    base.hold(HELD)
    *_, info = envs.step(chunk(actions))
    assert info["chunk"]["steps"].tolist() == [0, LENGTH] and base.held.tolist() == HELD.tolist()
    np.testing.assert_array_equal(base.scene(0).poses, before.poses)


def test_chunks_of_chunks(make, actions):
    one, two = vector.ActionChunk(make(), LENGTH), vector.ActionChunk(vector.ActionChunk(make(), 2), 2)
    late(one)
    late(two)
    flat = one.step(chunk(actions))
    nested = two.step(chunk(actions).reshape(2, 2, 2, 7))
    np.testing.assert_array_equal(flat[0]["points"], nested[0]["points"])
    np.testing.assert_allclose(flat[1], nested[1], atol=1e-6)
    assert flat[3].tolist() == nested[3].tolist() and two.unwrapped.done.tolist() == [True, False]


def test_what_is_held_is_not_penalised_and_never_unsure(make, actions):
    envs = vector.UncertaintyPenalty(make(), weight=1.0, limit=1e-6)
    envs.unwrapped.hold(HELD)
    envs.step(actions[0])
    envs.unwrapped.hold(HELD)
    _, reward, _, truncated, info = envs.step(actions[1])
    assert reward[0] == 0.0 and not truncated[0] and info["reason"][0] == ""


def test_a_restart_costs_nothing_though_its_error_is_known(make, actions, monkeypatch):
    envs = vector.UncertaintyPenalty(make(), weight=1.0)
    late(envs)
    for k in range(2):
        truncated = envs.step(actions[k])[3]
    assert truncated[0]
    monkeypatch.setattr("pwm_gym.wrappers.vector.total_error", lambda info: np.ones(2))
    assert envs.step(actions[2])[1][0] == 0.0


def test_texts_of_a_chunk_and_stable_baselines_take_it(make, actions):
    envs = NumpyToTorch(vector.ActionChunk(make(), LENGTH))
    late(envs)
    info = envs.step(torch.as_tensor(chunk(actions).copy()))[-1]
    assert info["reason"].tolist() == ["time limit", ""]
    chunks = SB3VecEnv(vector.ActionChunk(make("SameStep"), LENGTH))
    assert chunks.action_space.shape == (LENGTH, 7)
    chunks.reset()
    observation, reward, done, _ = chunks.step(chunk(actions))
    assert observation.shape == (2, *chunks.observation_space.shape)
    assert reward.shape == done.shape == (2,)


def test_what_has_ended_does_not_end_again_while_it_is_held(make, actions):
    envs = make()
    late(envs)
    assert [envs.step(actions[k])[3][0] for k in range(2)] == [False, True]
    envs.unwrapped.hold(HELD)
    assert [envs.step(actions[k])[3][0] for k in (2, 3)] == [False, False]
    assert envs.unwrapped.done[0]  # and restarts when it is let go
    envs.unwrapped.hold(~HELD)
    assert envs.step(actions[4])[1][0] == 0.0 and not envs.unwrapped.done[0]
