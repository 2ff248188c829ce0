import gymnasium as gym
import numpy as np
import pytest
from batches import LIMIT


@pytest.fixture
def make_batch():
    """Makes native batches of short episodes, reset with seed 0, and closes them."""
    made = []

    def make(mode="NextStep", num_envs=2, task="PickCube", **settings):
        envs = gym.make_vec(f"pwm/{task}-v0", num_envs, autoreset_mode=mode, max_episode_steps=LIMIT, **settings)
        envs.reset(seed=0)
        made.append(envs)
        return envs

    yield make
    for envs in made:
        envs.close()


@pytest.fixture
def actions():
    """Twelve random actions of two environments (12, 2, 7)."""
    return np.random.default_rng(3).uniform(-1, 1, (12, 2, 7)).astype(np.float32)
