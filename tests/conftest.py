"""Fixtures that all tests share. One thread: the suites of several processes then do not fight for cores."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import settings
from synthetic import WORLDS, Body, Recorder, World

import pwm_gym
from pwm_gym.collection import CollectConfig, collect
from pwm_gym.costs import COSTS
from pwm_gym.data import load_split
from pwm_gym.tasks import get_task

# The same few examples in every run; `pytest tests/properties --hypothesis-profile thorough` looks for new ones.
settings.register_profile("quick", max_examples=12, derandomize=True, deadline=None, database=None)
settings.register_profile("thorough", max_examples=1000, deadline=None)
settings.load_profile("quick")


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def sim():
    """PickCube's simulator twin, made once; each test resets it."""
    env = gym.make("pwm/PickCubeSim-v0")
    yield env
    env.close()


@pytest.fixture
def env():
    """PickCube's model environment."""
    env = gym.make("pwm/PickCube-v0")
    yield env
    env.close()


@pytest.fixture
def scene(env) -> pwm_gym.Scene:
    """A scene at rest of the shipped checkpoint's bank."""
    env.reset(seed=0)
    return env.unwrapped.scene()


@pytest.fixture
def costs():
    """Costs registered by the test are forgotten after it."""
    before = dict(COSTS)
    yield COSTS
    COSTS.clear()
    COSTS.update(before)


@pytest.fixture
def random_actions():
    """``random_actions(seed, *shape)``: actions in [-1, 1], float32."""

    def draw(seed: int, *shape: int) -> np.ndarray:
        return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)

    return draw


class _Stub:
    """A world model that moves the scene as a test says."""

    def __init__(self, model, move):
        self.links, self.action_size, self._model, self._move = model.links, model.action_size, model, move

    def prepare(self, state):
        return self._model.prepare(state)

    def step(self, state, action):
        return state.advance(self._move(state.poses().clone()))


@pytest.fixture
def replace_model():
    """``replace_model(env, move)``: the world moves by ``move(poses (B, E, 4, 4))``, or stands still."""

    def replace(env, move=lambda poses: poses):
        base = env.unwrapped
        core = getattr(base, "vector", base)
        core.model = _Stub(core.model, move)

    return replace


@pytest.fixture
def simulator(sim):
    """PickCube's simulator itself."""
    return sim.unwrapped.simulator


@pytest.fixture(scope="session")
def stack_simulator():
    """StackCube's simulator, made once; each test resets it."""
    simulator = get_task("StackCube").simulator()
    yield simulator
    simulator.close()


@pytest.fixture(scope="session")
def shape_cache(tmp_path_factory):
    """A user's cache of the generated shapes and their grasps, which take seconds to find: each is found once."""
    return tmp_path_factory.mktemp("assets")


@pytest.fixture(scope="module")
def only_shapes(shape_cache):
    """Folder of the generated shapes, with no YCB objects on this machine."""
    from pwm_gym.assets import generated_assets

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MS_ASSET_DIR", str(shape_cache / "none"))
        patch.setenv("XDG_CACHE_HOME", str(shape_cache))
        yield generated_assets()


@pytest.fixture(scope="module")
def bars(only_shapes, tmp_path_factory):
    """A small data set of PickYCB whose object is always the bar, for want of others kept out of training."""
    config = CollectConfig(
        task="PickYCB", objects="shape_bar", practice=1.0, episodes=1, held_out=2, workers=1,
        out=tmp_path_factory.mktemp("bars") / "set",
    )  # fmt: skip
    return collect(config, progress=False)


@pytest.fixture(scope="session")
def mug_simulator():
    """MugCleanup's simulator, made once; each test resets it."""
    simulator = get_task("MugCleanup").simulator()
    yield simulator
    simulator.close()


@pytest.fixture(scope="session")
def coffee_simulator():
    """Coffee's simulator, made once; each test resets it."""
    simulator = get_task("Coffee").simulator()
    yield simulator
    simulator.close()


@pytest.fixture(scope="session")
def data_config(tmp_path_factory) -> CollectConfig:
    """A data set of 4 demonstrations and 4 practice episodes, and one of each kind in validation and test."""
    return CollectConfig(out=tmp_path_factory.mktemp("data") / "set", episodes=8, held_out=2, workers=1, shard=2)


@pytest.fixture(scope="session")
def data_folder(data_config):
    """The data set of ``data_config``, collected once; tests copy it before they change it."""
    return collect(data_config, progress=False)


@pytest.fixture(scope="session")
def train_split(data_folder):
    """Training episodes of the small data set."""
    return load_split(data_folder, "train")


@pytest.fixture(scope="session")
def cut():
    """``cut(episode, steps)``: the episode's first steps."""

    def first(episode, steps):
        frames = {n: getattr(episode, n)[: steps + 1] for n in ("poses", "joints")}
        rest = {n: getattr(episode, n)[:steps] for n in ("actions", "rewards", "success", "grasped")}
        return replace(episode, **frames, **rest)

    return first


@pytest.fixture(scope="session")
def worlds() -> dict[str, World]:
    """Small synthetic scenes: one of each kind of robot and of joint."""
    return WORLDS


@pytest.fixture(scope="session")
def new_body():
    """Class of the bodies of :func:`worlds`."""
    return Body


@pytest.fixture(scope="session")
def recorder() -> Recorder:
    return Recorder()
