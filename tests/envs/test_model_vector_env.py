"""The native batch: spaces, seeds, scenes, equality with single environments."""

import copy
import pickle
import sys
import types

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.utils import performance
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics, RecordVideo

from pwm_gym.dynamics.checkpoint import default_checkpoints
from pwm_gym.envs import ModelVectorEnv
from pwm_gym.errors import PwmGymError
from pwm_gym.tasks import TASKS

IDS = [
    pytest.param(f"pwm/{task}-v0", marks=[pytest.mark.slow] if TASKS[task].layout.points > 8192 else [])
    for task in sorted(default_checkpoints())
]
STEPS = 10
MODES = list(AutoresetMode)


def make(num_envs=3, name="pwm/PickCube-v0", **kwargs) -> gym.vector.VectorEnv:
    return gym.make_vec(name, num_envs=num_envs, **kwargs)


def rollout(env, seed, actions) -> list:
    return [env.reset(seed=seed), *(env.step(a) for a in actions)]


def assert_near(a, b, tolerance=1e-5):
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_allclose(a[name], b[name], atol=tolerance, rtol=0, err_msg=name)


@pytest.mark.parametrize("name", IDS)
def test_make_vec_gives_one_native_batch(name):
    env = make(5, name)
    assert type(env) is ModelVectorEnv
    assert env.num_envs == 5
    assert env.max_episode_steps == TASKS[env.task.name].max_episode_steps
    assert type(env.metadata["autoreset_mode"]) is AutoresetMode
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    single = gym.make(name)
    assert env.single_observation_space == single.observation_space
    assert env.single_action_space == single.action_space
    assert env.action_space.shape == (5, *single.action_space.shape)


@pytest.mark.parametrize("mode", MODES)
def test_modes_stand_in_the_metadata_of_their_own_env(mode):
    env = make(1, autoreset_mode=mode.value)
    assert env.metadata["autoreset_mode"] is mode
    assert ModelVectorEnv.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


def test_a_step_is_one_forward_pass(random_actions):
    env = make(4)
    env.reset(seed=0)
    calls = []
    step = env.model.step
    env.model = types.SimpleNamespace(
        prepare=env.model.prepare, step=lambda s, a: calls.append(tuple(a.shape)) or step(s, a)
    )
    env.step(random_actions(0, 4, 7))
    assert calls == [(4, 7)]


def test_types_and_spaces(random_actions):
    env = make(3)
    observation, info = env.reset(seed=0)
    for action in random_actions(0, 3, 3, 7):
        assert observation in env.observation_space
        assert all(type(v) is np.ndarray and v.dtype == np.float32 for v in observation.values())
        observation, reward, terminated, truncated, info = env.step(action)
        assert reward.shape == (3,) and reward.dtype.kind == "f"
        assert all(x.shape == (3,) and x.dtype == bool for x in (terminated, truncated))
    assert info["success"].shape == info["grasped"].shape == info["reason"].shape == (3,)
    assert info["_success"].all() and info["cost_terms"]["_reaching"].all()
    np.testing.assert_allclose(reward, -sum(v for k, v in info["cost_terms"].items() if k[0] != "_"), atol=1e-6)


def test_info_keys_are_stable(random_actions):
    env = make(2, max_episode_steps=2)
    infos = [x[-1] for x in rollout(env, 0, random_actions(0, 4, 2, 7))]
    assert all(list(i) == list(infos[0]) for i in infos)
    assert all(list(i["cost_terms"]) == list(infos[0]["cost_terms"]) for i in infos)


def test_returned_arrays_are_not_reused(random_actions):
    env = make(2)
    results = rollout(env, 0, random_actions(0, 3, 2, 7))
    arrays = [a for o, *_ in results for a in o.values()]
    arrays += [r[1] for r in results[1:]] + [r[-1]["success"] for r in results]
    assert not any(np.shares_memory(a, b) for i, a in enumerate(arrays) for b in arrays[:i])


def test_pickles(random_actions):
    env = make(2, max_episode_steps=3)
    actions = random_actions(1, 5, 2, 7)
    assert pickle.dumps(env)
    again = copy.deepcopy(env)  # by the protocol that pickle uses
    assert data_equivalence(rollout(again, 3, actions), rollout(env, 3, actions), exact=True)


def test_closing_twice_is_harmless():
    env = make(1)
    env.close()
    env.close()


# Seeds


def test_an_integer_seed_means_seed_plus_i():
    three = make(3).reset(seed=11)[0]["points"]
    for i in range(3):
        np.testing.assert_array_equal(three[i], make(1).reset(seed=11 + i)[0]["points"][0])
    assert len({p.tobytes() for p in three}) == 3


def test_lists_of_seeds():
    env = make(3)
    by_list = env.reset(seed=[13, None, 11])[0]["points"]
    by_integer = env.reset(seed=11)[0]["points"]
    np.testing.assert_array_equal(by_list[[0, 2]], by_integer[[2, 0]])


def test_numpy_seeds():
    env = make(2)
    np.testing.assert_array_equal(env.reset(seed=np.int64(3))[0]["points"], env.reset(seed=3)[0]["points"])


def test_wrong_number_of_seeds():
    with pytest.raises(PwmGymError, match="2 seeds for 3 environments"):
        make(3).reset(seed=[1, 2])


# Equality with single environments


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_equals_sync_vector_env(name, mode, random_actions):
    """Through two restarts: episodes of four steps."""
    env = make(3, name, max_episode_steps=4, autoreset_mode=mode)
    sync = SyncVectorEnv([lambda: gym.make(name, max_episode_steps=4)] * 3, autoreset_mode=mode)
    actions = random_actions(0, STEPS, 3, *env.single_action_space.shape)
    ours, theirs = rollout(env, 21, actions), rollout(sync, 21, actions)
    assert_near(ours[0][0], theirs[0][0])
    restarts = 0
    for (o, r, te, tr, info), (so, sr, ste, stru, sinfo) in zip(ours[1:], theirs[1:], strict=True):
        assert_near(o, so)
        np.testing.assert_allclose(r, sr, atol=1e-4)
        np.testing.assert_array_equal(te, ste)
        np.testing.assert_array_equal(tr, stru)
        np.testing.assert_array_equal(info["success"], sinfo["success"])
        np.testing.assert_array_equal(info["grasped"], sinfo["grasped"])
        for term, values in info["cost_terms"].items():
            np.testing.assert_allclose(values, sinfo["cost_terms"][term], atol=1e-4)
        restarts += tr.all()
        if "final_obs" in sinfo:
            np.testing.assert_array_equal(info["_final_obs"], sinfo["_final_obs"])
            for i in np.flatnonzero(sinfo["_final_obs"]):
                assert_near({k: v[i] for k, v in info["final_obs"].items()}, sinfo["final_obs"][i])
        assert ("final_obs" in info) == ("final_obs" in sinfo)
    assert restarts == 2


def test_values_do_not_depend_on_the_batchs_neighbours(random_actions):
    actions = random_actions(0, STEPS, 3, 7)
    other = actions.copy()
    other[:, 1:] = random_actions(1, STEPS, 2, 7)
    first, second = rollout(make(3), [5, 6, 7], actions), rollout(make(3), [5, 60, 70], other)
    alone = rollout(make(1), 5, actions[:, :1])
    for a, b, c in zip(first, second, alone, strict=True):
        assert_near({k: v[0] for k, v in a[0].items()}, {k: v[0] for k, v in b[0].items()})
        assert_near({k: v[0] for k, v in a[0].items()}, {k: v[0] for k, v in c[0].items()})


def test_a_neighbour_that_leaves_the_bounds_changes_nothing(replace_model):
    env = make(2)
    before, _ = env.reset(seed=0)

    def lose_the_second(poses):
        poses[1] = torch.nan
        return poses

    replace_model(env, lose_the_second)
    observation, reward, terminated, truncated, info = env.step(np.zeros((2, 7), np.float32))
    np.testing.assert_array_equal(truncated, [False, True])
    assert not terminated.any() and np.isfinite(reward).all()
    assert list(info["reason"]) == ["", "left the bounds"]
    np.testing.assert_allclose(observation["points"][0], before["points"][0], atol=1e-6)
    assert observation in env.observation_space
    observation, reward, terminated, truncated, info = env.step(np.zeros((2, 7), np.float32))
    np.testing.assert_array_equal(truncated, [False, False])
    assert list(info["reason"]) == ["", ""] and reward[1] == 0
    assert observation in env.observation_space


# Scenes


def test_one_scene_for_all_and_one_each(random_actions):
    env = make(2)
    env.reset(seed=0)
    env.step(random_actions(0, 2, 7))
    scenes = [env.scene(0), env.scene(1)]
    same, _ = env.reset(options={"scene": scenes[1]})
    np.testing.assert_array_equal(same["points"][0], same["points"][1])
    each, _ = env.reset(options={"scene": scenes})
    np.testing.assert_array_equal(each["points"][1], same["points"][1])
    assert (each["points"][0] != each["points"][1]).any()
    with pytest.raises(PwmGymError, match="1 scenes for 2 environments"):
        env.reset(options={"scene": scenes[:1]})


# Wrappers, torch, time


def test_record_episode_statistics(random_actions):
    env = RecordEpisodeStatistics(make(2, max_episode_steps=3))
    results = rollout(env, 0, random_actions(0, 3, 2, 7))
    episode = results[-1][-1]["episode"]
    np.testing.assert_array_equal(episode["l"], [3, 3])
    np.testing.assert_allclose(episode["r"], sum(x[1] for x in results[1:]), atol=1e-5)


def test_renders_a_picture_of_each():
    env = make(2, render_mode="rgb_array")
    env.reset(seed=0)
    pictures = env.render()
    assert isinstance(pictures, tuple) and len(pictures) == 2
    assert all(p.dtype == np.uint8 and p.ndim == 3 and p.shape[-1] == 3 for p in pictures)
    assert (pictures[0] != pictures[1]).any()
    assert make(1).render() is None


def test_record_video(monkeypatch, tmp_path, random_actions):
    """With a stand-in for moviepy's writer: what RecordVideo asks of the environment is all there."""
    clips = []

    class Clip:
        def __init__(self, frames, fps):
            clips.append((np.stack(frames), fps))

        def write_videofile(self, path, logger=None):
            assert str(tmp_path) in path

    for name in ("moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip"):
        module = types.ModuleType(name)
        module.ImageSequenceClip = Clip
        monkeypatch.setitem(sys.modules, name, module)
    env = RecordVideo(
        make(2, render_mode="rgb_array"),
        str(tmp_path / "videos"),
        step_trigger=lambda s: s == 0,
        video_length=2,
    )
    rollout(env, 0, random_actions(0, 3, 2, 7))
    env.close()
    (frames, fps), *_ = clips
    assert fps == env.metadata["render_fps"] == 20
    assert len(frames) >= 2 and frames.dtype == np.uint8 and (frames[0] != frames[1]).any()


def test_tensors_out(random_actions):
    env, plain = make(2, tensors=True, max_episode_steps=3), make(2, max_episode_steps=3)
    actions = random_actions(0, 5, 2, 7)
    for ours, theirs in zip(rollout(env, 0, torch.from_numpy(actions)), rollout(plain, 0, actions), strict=True):
        assert all(isinstance(v, torch.Tensor) and v.device == env.device for v in ours[0].values())
        for name, value in theirs[0].items():
            np.testing.assert_array_equal(ours[0][name].numpy(), value)
        if len(ours) == 5:
            assert isinstance(ours[1], torch.Tensor) and not ours[1].requires_grad
            np.testing.assert_array_equal(ours[1].numpy(), theirs[1])


def test_tensors_are_not_reused(random_actions):
    env = make(1, tensors=True)
    results = rollout(env, 0, torch.from_numpy(random_actions(0, 3, 1, 7)))
    pointers = [v.data_ptr() for o, *_ in results for v in o.values()]
    assert len(set(pointers)) == len(pointers)
    action = torch.zeros(1, 7)
    env.step(action)
    action += 1
    assert not env.scene().last_action.any()


def test_no_time_limit_when_none():
    env = ModelVectorEnv("PickCube", num_envs=1)
    env.reset(seed=0)
    assert not any(env.step(np.zeros((1, 7), np.float32))[3].any() for _ in range(3))


def test_gymnasiums_benchmark_runs():
    assert performance.benchmark_vector_step(make(2), target_duration=0.2) > 0
