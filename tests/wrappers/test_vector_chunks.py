"""Chunks of actions in the native batch: each row as the single environment makes it, in every autoreset mode."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
from batches import LIMIT, late
from gymnasium.wrappers.vector import NumpyToTorch

from pwm_gym.errors import PwmGymError
from pwm_gym.wrappers import ActionChunk, SB3VecEnv, vector

LENGTH = 4  # the second chunk ends after two of its actions
HELD = np.array([True, False])


@pytest.fixture
def make(make_batch):
    return partial(make_batch, num_envs=3)


@pytest.fixture
def chunks():
    return np.random.default_rng(0).uniform(-1, 1, (4, 3, LENGTH, 7)).astype(np.float32)


def test_a_chunk_is_its_actions_one_after_the_other(make, chunks):
    plain, chunked = make(), vector.ActionChunk(make(), LENGTH)
    plain.reset(seed=0)
    chunked.reset(seed=0)
    steps = [plain.step(chunks[0][:, k]) for k in range(LENGTH)]
    observation, reward, terminated, truncated, info = chunked.step(chunks[0])
    np.testing.assert_array_equal(observation["points"], steps[-1][0]["points"])
    np.testing.assert_array_equal(info["chunk"]["rewards"], np.stack([step[1] for step in steps], 1))
    np.testing.assert_allclose(reward, info["chunk"]["rewards"].sum(1), rtol=1e-6)
    assert (info["chunk"]["steps"] == LENGTH).all() and not (terminated | truncated).any()
    assert chunks[0] in chunked.action_space


def test_a_batch_of_chunks_is_single_environments_with_chunks(make, chunks):
    batch = vector.ActionChunk(make("Disabled"), LENGTH)
    batch.reset(seed=0)
    rows = [batch.step(part) for part in chunks[:2]]
    for i in range(3):
        env = ActionChunk(gym.make("pwm/PickCube-v0", max_episode_steps=LIMIT), LENGTH)
        env.reset(options={"scene": _first_scene(make, i)})
        for part, (observation, reward, terminated, truncated, info) in zip(chunks, rows, strict=False):
            alone = env.step(part[i])
            np.testing.assert_allclose(observation["points"][i], alone[0]["points"], atol=2e-5)
            assert reward[i] == pytest.approx(alone[1], abs=1e-4)
            assert (bool(terminated[i]), bool(truncated[i])) == alone[2:4]
            assert info["chunk"]["steps"][i] == len(alone[4]["chunk"]["rewards"])
        assert alone[3] and info["reason"][i] == "time limit"


def _first_scene(make, index):
    envs = make("Disabled")
    envs.reset(seed=0)
    return envs.scene(index)


def test_what_restarts_makes_none_of_the_chunk(make, chunks):
    envs = vector.ActionChunk(make(), LENGTH)
    envs.reset(seed=0)
    envs.step(chunks[0])
    *_, truncated, info = envs.step(chunks[1])
    assert truncated.all() and (info["chunk"]["steps"] == 2).all()
    observation, reward, terminated, truncated, info = envs.step(chunks[2])
    assert not (terminated | truncated).any() and (reward == 0).all() and (info["chunk"]["steps"] == 0).all()
    fresh = envs.unwrapped.scene(0)
    np.testing.assert_array_equal(fresh.poses[0], fresh.poses[1])  # at rest: nothing was made since the start
    np.testing.assert_allclose(observation["points"][0], envs.unwrapped.state.points()[0].numpy(), atol=1e-6)
    assert (envs.step(chunks[3])[-1]["chunk"]["steps"] == LENGTH).all()


def test_an_episode_that_ends_within_the_chunk_waits_for_the_others(make, chunks):
    envs = make("Disabled")
    envs.reset(seed=0)
    chunked = vector.ActionChunk(envs, LENGTH)
    chunked.step(chunks[0])
    mask = np.array([True, False, False])
    envs.reset(seed=7, options={"reset_mask": mask})
    observation, _, terminated, truncated, info = chunked.step(chunks[1])
    assert truncated.tolist() == [False, True, True] and not terminated.any()
    assert info["chunk"]["steps"].tolist() == [4, 2, 2]
    assert info["reason"].tolist() == ["", "time limit", "time limit"]
    assert (info["chunk"]["rewards"][1:, 2:] == 0).all() and (info["chunk"]["rewards"][0] != 0).all()
    np.testing.assert_allclose(observation["points"][1], envs.unwrapped.state.points()[1].numpy(), atol=1e-6)
    with pytest.raises(PwmGymError, match="some environments are done"):
        chunked.step(chunks[2])
    envs.reset(seed=8, options={"reset_mask": ~mask})
    assert chunked.step(chunks[2])[-1]["chunk"]["steps"].tolist() == [2, 4, 4]


def test_last_observations_of_a_chunk_are_kept_with_restarts_at_once(make, chunks):
    plain, chunked = make("SameStep"), vector.ActionChunk(make("SameStep"), LENGTH)
    plain.reset(seed=0)
    chunked.reset(seed=0)
    chunked.step(chunks[0])
    for k in range(LENGTH):
        plain.step(chunks[0][:, k])
    for k in range(2):
        first, *_, told = plain.step(chunks[1][:, k])
    observation, _, _, truncated, info = chunked.step(chunks[1])
    assert truncated.all() and info["_final_obs"].all()
    np.testing.assert_array_equal(info["final_obs"]["points"], told["final_obs"]["points"])
    assert info["final_info"]["reason"].tolist() == ["time limit"] * 3 and info["reason"].tolist() == [""] * 3
    np.testing.assert_array_equal(observation["points"], first["points"])
    assert (chunked.step(chunks[2])[-1]["chunk"]["steps"] == LENGTH).all()


def test_chunks_of_tensors(make, chunks):
    envs = vector.ActionChunk(make(tensors=True), LENGTH)
    envs.reset(seed=0)
    observation, reward, *_ = envs.step(torch.as_tensor(chunks[0]))
    assert isinstance(observation["points"], torch.Tensor) and isinstance(reward, torch.Tensor)
    assert reward.shape == (3,)


def test_chunks_that_cannot_be(make, chunks):
    with pytest.raises(PwmGymError, match="length=0; expected a whole number of at least 1"):
        vector.ActionChunk(make(), 0)
    envs = vector.ActionChunk(make(), LENGTH)
    envs.reset(seed=0)
    with pytest.raises(PwmGymError, match=r"\(3, 3, 7\).*\(3, 4, 7\)"):
        envs.step(chunks[0][:, :3])
    with pytest.raises(PwmGymError, match=r"mask is bool \(2,\); expected a boolean array \(3,\)"):
        envs.unwrapped.hold(np.zeros(2, bool))
    assert (envs.step(chunks[0])[-1]["chunk"]["steps"] == LENGTH).all()


def chunk(actions, first=0):
    """Chunks (2, LENGTH, 7) of the actions from ``first`` on."""
    return actions[first : first + LENGTH].swapaxes(0, 1)


@pytest.mark.parametrize("tensors", [False, True])
def test_rows_of_a_chunk_end_at_different_actions(make_batch, actions, tensors):
    plain, chunked = make_batch(tensors=tensors), vector.ActionChunk(make_batch(tensors=tensors), LENGTH)
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


def test_rows_that_restart_at_once_within_a_chunk_wait(make_batch, actions):
    plain, chunked = make_batch("SameStep"), vector.ActionChunk(make_batch("SameStep"), LENGTH)
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


def test_a_chunk_heeds_who_is_held_already(make_batch, actions):
    envs = vector.ActionChunk(make_batch(), LENGTH)
    base = envs.unwrapped
    before = base.scene(0)
    base.hold(HELD)
    *_, info = envs.step(chunk(actions))
    assert info["chunk"]["steps"].tolist() == [0, LENGTH] and base.held.tolist() == HELD.tolist()
    np.testing.assert_array_equal(base.scene(0).poses, before.poses)


def test_chunks_of_chunks(make_batch, actions):
    one, two = vector.ActionChunk(make_batch(), LENGTH), vector.ActionChunk(vector.ActionChunk(make_batch(), 2), 2)
    late(one)
    late(two)
    flat = one.step(chunk(actions))
    nested = two.step(chunk(actions).reshape(2, 2, 2, 7))
    np.testing.assert_array_equal(flat[0]["points"], nested[0]["points"])
    np.testing.assert_allclose(flat[1], nested[1], atol=1e-6)
    assert flat[3].tolist() == nested[3].tolist() and two.unwrapped.done.tolist() == [True, False]


def test_texts_of_a_chunk_and_stable_baselines_take_it(make_batch, actions):
    envs = NumpyToTorch(vector.ActionChunk(make_batch(), LENGTH))
    late(envs)
    info = envs.step(torch.as_tensor(chunk(actions).copy()))[-1]
    assert info["reason"].tolist() == ["time limit", ""]
    chunks = SB3VecEnv(vector.ActionChunk(make_batch("SameStep"), LENGTH))
    assert chunks.action_space.shape == (LENGTH, 7)
    chunks.reset()
    observation, reward, done, _ = chunks.step(chunk(actions))
    assert observation.shape == (2, *chunks.observation_space.shape)
    assert reward.shape == done.shape == (2,)
