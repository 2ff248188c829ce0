"""What Gymnasium asks of third-party environments, for every registered id that can be made here.

One task of each robot is asked in every run; the others, and robots whose tasks all have large clouds, are slow tests.
Model environments of tasks without a shipped checkpoint cannot be made.
"""

import copy
import json
import pickle
import random
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import performance
from gymnasium.utils.env_checker import check_env, data_equivalence

import pwm_gym
from pwm_gym.dynamics.checkpoint import default_checkpoints
from pwm_gym.envs import ModelEnv, ModelVectorEnv, SimEnv
from pwm_gym.tasks import TASKS

EVERY = sorted(i for i in gym.registry if i.startswith("pwm/"))
QUICK = [task for task in TASKS.values() if task.layout.points <= 4096]
FIRST = {task.robot.name.partition("_")[0]: task.name for task in reversed(QUICK)}  # of each family of robots


def chosen(kinds: tuple[str, ...]) -> list:
    """Ids of these kinds ("" is the model's), those of tasks that stand for no robot marked as slow."""
    out = []
    for task in TASKS.values():
        marks = [] if task.name in FIRST.values() else [pytest.mark.slow]
        able = [kind for kind in kinds if kind == "Sim" or task.name in default_checkpoints()]
        out += [pytest.param(f"pwm/{task.name}{kind}-v0", marks=marks) for kind in able]
    return out


IDS, MODEL_IDS = chosen(("", "Sim")), chosen(("",))
INFO = {"success", "grasped", "cost_terms", "reason"}


def twin_of(name: str) -> str:
    return name.replace("-v", "Sim-v")


@pytest.fixture(scope="module")
def made():
    """Each id's environment, made once."""
    envs = {}

    def get(name: str) -> gym.Env:
        if name not in envs:
            envs[name] = gym.make(name)
        return envs[name]

    yield get
    for env in envs.values():
        env.close()


@pytest.fixture(params=IDS)
def each(request, made):
    return made(request.param)


def rollout(env, seed: int, steps: int) -> list:
    out = [env.reset(seed=seed)]
    actions = np.random.default_rng(seed).uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)
    return out + [env.step(a) for a in actions]


def rng_states() -> list[int]:
    states = torch.get_rng_state().numpy().tobytes(), repr(np.random.get_state()), random.getstate()  # noqa: NPY002
    return list(map(hash, states))


# Registration


def test_every_task_has_both_twins():
    assert set(EVERY) == {f"pwm/{t}{kind}-v0" for t in TASKS for kind in ("", "Sim")}
    assert {"pwm/PickCube-v0", "pwm/StackCube-v0"} <= set(EVERY)


def test_registering_again_is_harmless():
    before = {i: gym.spec(i) for i in EVERY}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pwm_gym.register_envs()
        gym.register_envs(pwm_gym)
    assert {i: gym.spec(i) for i in gym.registry if i.startswith("pwm/")} == before


def test_module_prefix_registers_in_a_fresh_process():
    code = "import gymnasium as gym; print(gym.make('pwm_gym:pwm/PickCube-v0').unwrapped)"
    out = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "<ModelEnv<pwm/PickCube-v0>>"


@pytest.mark.parametrize("name", IDS)
def test_spec(name):
    spec = gym.spec(name)
    points = [spec.entry_point, spec.vector_entry_point]
    assert all(isinstance(p, str) for p in points if p is not None)
    assert spec.max_episode_steps == TASKS[spec.kwargs["task"]].max_episode_steps > 0
    assert spec.nondeterministic is False
    assert json.loads(json.dumps(spec.kwargs)) == spec.kwargs
    assert EnvSpec.from_json(spec.to_json()) == spec


def test_spec_of_a_made_env_makes_an_equal_one(each):
    spec = EnvSpec.from_json(each.spec.to_json())
    again = gym.make(spec)
    assert type(again.unwrapped) is type(each.unwrapped)
    assert again.observation_space == each.observation_space
    assert data_equivalence(again.reset(seed=4)[0], each.reset(seed=4)[0], exact=True)
    again.close()


def test_spec_keeps_a_named_cost():
    env = gym.make("pwm/PickCube-v0", cost="pick_cube_plan")
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.rules.cost.name == "pick_cube_plan"


@pytest.mark.parametrize("name", MODEL_IDS)
def test_twins_have_equal_spaces_and_entities(name, made):
    model, simulator = made(name), made(twin_of(name))
    assert model.action_space == simulator.action_space
    assert model.observation_space == simulator.observation_space
    assert model.unwrapped.entities == simulator.unwrapped.entities
    assert model.metadata == simulator.metadata
    assert model.spec.max_episode_steps == simulator.spec.max_episode_steps


@pytest.mark.parametrize("cls", [ModelEnv, SimEnv])
def test_docstring_has_gymnasiums_sections(cls):
    sections = ["Description", "Action space", "Observation space", "Reward", "Starting state", "Episode end"]
    missing = [s for s in [*sections, "Arguments", "Version history"] if f"## {s}" not in cls.__doc__]
    assert not missing
    assert "* v0:" in cls.__doc__


def test_package_is_typed():
    assert (Path(pwm_gym.__file__).parent / "py.typed").exists()
    for cls, base in ((ModelEnv, gym.Env), (SimEnv, gym.Env), (ModelVectorEnv, gym.vector.VectorEnv)):
        generic = [b for b in cls.__orig_bases__ if getattr(b, "__origin__", None) is base]
        assert generic and generic[0].__args__[0] == dict[str, np.ndarray]


# Env


def test_check_env_is_clean(each):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", DeprecationWarning)  # mani_skill's and sapien's own
        check_env(each.unwrapped)


def test_passive_checker_is_clean(each):
    assert "PassiveEnvChecker" in str(each)
    env = gym.make(each.spec, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", DeprecationWarning)
        rollout(env, 0, 3)
        env.render()
    env.close()


@pytest.mark.parametrize("name", MODEL_IDS)
def test_same_seed_same_rollout(name, made):
    env = made(name)
    first = rollout(env, 7, 50)
    torch.manual_seed(1)  # whatever the global generator is at
    assert data_equivalence(rollout(env, 7, 50), first, exact=True)


def test_same_seed_same_rollout_in_another_instance(each):
    again = gym.make(each.spec)
    assert data_equivalence(rollout(again, 3, 10), rollout(each, 3, 10), exact=True)
    again.close()


def test_seeds_differ_and_unseeded_resets_go_on(each):
    def starts():
        return [each.reset(seed=0)[0], *(each.reset()[0] for _ in range(3)), each.reset(seed=1)[0]]

    first = starts()
    assert len({o["points"].tobytes() + o["goal"].tobytes() for o in first}) >= 4
    assert data_equivalence(starts(), first, exact=True)


def test_global_generators_are_untouched(each):
    before = rng_states()
    rollout(each, 0, 5)
    each.reset()
    each.step(np.zeros(each.action_space.shape, np.float32))
    assert rng_states() == before


@pytest.mark.parametrize("name", IDS)
def test_making_leaves_global_generators_untouched(name):
    before = rng_states()
    gym.make(name).close()
    assert rng_states() == before


def test_pickles(each):
    assert pickle.dumps(each)
    again = copy.deepcopy(each)  # by the protocol that pickle uses
    assert data_equivalence(rollout(again, 2, 5), rollout(each, 2, 5), exact=True)
    again.close()


def test_observations_are_numpy_inside_the_space(each):
    for observation, *_ in rollout(each, 5, 10):
        assert observation in each.observation_space
        for name, value in observation.items():
            assert type(value) is np.ndarray
            assert value.dtype == each.observation_space[name].dtype == np.float32


def test_step_returns_plain_types(each):
    each.reset(seed=0)
    _, reward, terminated, truncated, info = each.step(np.zeros(each.action_space.shape, np.float32))
    assert [type(x) for x in (reward, terminated, truncated)] == [float, bool, bool]
    assert type(info["success"]) is bool and type(info["grasped"]) is bool
    assert all(type(v) is float for v in info["cost_terms"].values())


def test_spaces_are_finite(each):
    for space in each.observation_space.values():
        assert np.isfinite(space.low).all() and np.isfinite(space.high).all()
    assert (each.action_space.low == -1).all() and (each.action_space.high == 1).all()


def test_observation_is_the_entities_points(each):
    observation, _ = each.reset(seed=0)
    base = each.unwrapped
    assert base.entities[-1].stop == len(observation["points"])
    assert {e.name for e in base.entities} >= {*base.task.robot.links}
    for e in base.entities:
        centre = base.state.entity(e.name)[0].double().mean(0).numpy()
        np.testing.assert_allclose(observation["points"][e.slice].mean(0, dtype=np.float64), centre, atol=1e-6)


def test_velocities_are_the_points_differences(each):
    steps = [o for o, *_ in rollout(each, 1, 3)]
    assert not steps[0]["velocity"].any() and not steps[0]["previous_velocity"].any()
    assert np.abs(steps[3]["velocity"]).max() > 1e-4
    np.testing.assert_allclose(steps[3]["velocity"], steps[3]["points"] - steps[2]["points"], atol=1e-6)
    np.testing.assert_allclose(steps[3]["previous_velocity"], steps[2]["velocity"], atol=1e-6)


def test_returned_data_is_not_reused(each):
    kept = rollout(each, 0, 3)
    snapshot = copy.deepcopy(kept)
    more = rollout(each, 1, 3)
    assert data_equivalence(kept, snapshot, exact=True)
    arrays = [a for o, *_ in [*kept, *more] for a in o.values()]
    assert not any(np.shares_memory(a, b) for i, a in enumerate(arrays) for b in arrays[:i])


def test_writing_to_an_observation_changes_nothing(each):
    expected = rollout(each, 0, 2)[-1][0]
    for value in each.reset(seed=0)[0].values():
        value[:] = 1.0
    actions = np.random.default_rng(0).uniform(-1, 1, (2, *each.action_space.shape)).astype(np.float32)
    for a in actions:
        last = each.step(a)[0]
        copied = copy.deepcopy(last)
        for value in last.values():
            value[:] = 1.0
    assert data_equivalence(copied, expected, exact=True)


def test_actions_are_copied(each):
    """A policy may reuse its action's buffer, and may hand out a read-only one."""
    each.reset(seed=0)
    action = np.full(each.action_space.shape, 0.5, np.float32)
    each.step(action)
    action[:] = -1.0
    assert (each.unwrapped.scene().last_action == 0.5).all()
    action.setflags(write=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # torch's about arrays that are not writable
        each.unwrapped.step(action)


def test_float64_actions_are_welcome(each):
    each.reset(seed=0)
    assert each.unwrapped.step(np.zeros(each.action_space.shape))[0] in each.observation_space


@pytest.mark.parametrize("name", IDS)
def test_every_render_mode(name, made):
    modes, fps = made(name).metadata["render_modes"], made(name).metadata["render_fps"]
    assert modes == ["rgb_array"] and fps == 20
    env = gym.make(name, render_mode="rgb_array")
    pictures = []
    for seed in range(2):
        env.reset(seed=seed)
        pictures.append(env.render())
    for picture in pictures:
        assert picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[-1] == 3
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20
    assert (pictures[0] != pictures[1]).any()
    env.close()


def test_no_render_mode_no_picture(each):
    each.reset(seed=0)
    assert each.unwrapped.render() is None


@pytest.mark.parametrize("name", IDS)
def test_time_truncates(name):
    env = gym.make(name, max_episode_steps=3)
    ends = [(terminated, truncated) for *_, terminated, truncated, _ in rollout(env, 0, 3)[1:]]
    assert ends == [(False, False), (False, False), (False, True)]
    env.close()


def test_info_keys_are_stable(each):
    (_, first), *steps = rollout(each, 0, 5)
    assert set(first) >= INFO
    assert list(first["cost_terms"]) == list(each.unwrapped.rules.cost.terms)
    for *_, info in steps:
        assert list(info) == list(first)
        assert list(info["cost_terms"]) == list(first["cost_terms"])


def test_reward_is_minus_the_costs_terms(each):
    for *_, reward, _, _, info in (s for s in rollout(each, 0, 5)[1:]):
        assert reward == pytest.approx(-sum(info["cost_terms"].values()), abs=1e-6)


def test_points_argument(each):
    env = gym.make(each.spec, points=600)
    for observation, *_ in rollout(env, 0, 2):
        assert observation["points"].shape == (600, 3)
        assert observation in env.observation_space
    assert env.unwrapped.entities[-1].stop == 600
    env.close()


def test_points_argument_keeps_the_motion(env):
    """Fewer points are fewer observed points, not another start."""
    fewer = gym.make(env.spec, points=600)
    full, some = env.reset(seed=0)[0], fewer.reset(seed=0)[0]
    for a, b in zip(env.unwrapped.entities, fewer.unwrapped.entities, strict=True):
        kept = {tuple(p) for p in full["points"][a.slice].round(5)}
        assert all(tuple(p) in kept for p in some["points"][b.slice].round(5))


@pytest.mark.parametrize("name", IDS)
def test_closing_twice_is_harmless(name):
    env = gym.make(name)
    env.reset(seed=0)
    env.close()
    env.close()
    env.unwrapped.close()


def test_gymnasiums_benchmark_runs(env):
    assert performance.benchmark_step(env, target_duration=0.2, seed=0) > 0
