"""Observations of the Adroit environments give the states that they were made of."""

import numpy as np
import pytest

from pwm_gym.sim.mujoco.adroit import AdroitWorld
from pwm_gym.sim.mujoco.adroit_starts import JointState, start_door, start_relocate

STARTS = {"AdroitHandDoor-v1": start_door, "AdroitHandRelocate-v1": start_relocate}
TARGET = {"AdroitHandDoor-v1": None, "AdroitHandRelocate-v1": "target"}


@pytest.fixture(params=STARTS)
def case(request):
    """A world, and what puts it where an observation has it."""
    world = AdroitWorld(request.param, TARGET[request.param])
    yield world, STARTS[request.param]
    world.close()


def disturb(world, seed):
    """Bring everything somewhere: hand bent, door ajar or ball in the air, in motion; returns qpos, qvel."""
    rng = np.random.default_rng(seed)
    world.reset(seed)
    positions, velocities = np.array(world.env.init_qpos), rng.normal(0.0, 1.0, world.model.nv)
    positions[:] += rng.uniform(0.0, 0.3, len(positions))
    world.env.set_state(positions, velocities)
    return positions, velocities


def places(world):
    """Places (n, 3) of all bodies, and the goal."""
    return np.concatenate([world.data.xpos, world.goal().reshape(-1, 3)])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("told", [False, True])
def test_everything_is_where_it_was_observed(case, seed, told):
    world, start = case
    joints = JointState(*disturb(world, seed))
    observation, before = world.env._get_obs(), places(world)
    world.reset(seed + 10)
    start(world, observation, joints if told else None)
    np.testing.assert_allclose(world.observation, observation, atol=1e-9)
    np.testing.assert_allclose(places(world), before, atol=1e-9)
    np.testing.assert_array_equal(world.data.qvel, joints.velocities if told else 0.0)


def test_a_step_keeps_what_the_environment_showed(case):
    world, _ = case
    world.reset(0)
    shown = world.observation.copy()
    world.step(np.ones(world.action_size, np.float32))
    assert world.observation.shape == (39,) and np.abs(world.observation - shown).max() > 1e-4
