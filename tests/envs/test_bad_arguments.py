"""Arguments, seeds, options and costs that cannot be give one error that names the value and what was expected."""

import gymnasium as gym
import numpy as np
import pytest

import pwm_gym
from pwm_gym.envs import ModelVectorEnv
from pwm_gym.errors import PwmGymError

BATCH = {"id": "pwm/PickCube-v0", "num_envs": 2}
WHOLE = "expected a whole number"
SEED = r"expected a whole number from 0 to 2\*\*63 - 1"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"task": None}, "unknown task None; known: "),
        ({"task": ["PickCube"]}, r"unknown task \['PickCube'\]; known: "),
        ({"cost": 3}, "unknown cost 3; known: "),
        ({"checkpoint": None}, "unknown checkpoint None; known: adroit-door, "),
        ({"points": 100.5}, f"points=100.5; {WHOLE} from 4 to 1200"),
        ({"points": "a"}, f"points='a'; {WHOLE}"),
        ({"num_envs": "3"}, f"num_envs='3'; {WHOLE} of at least 1"),
        ({"num_envs": True}, f"num_envs=True; {WHOLE}"),
        ({"max_episode_steps": 0}, f"max_episode_steps=0; {WHOLE} of at least 1"),
        ({"max_episode_steps": "a"}, f"max_episode_steps='a'; {WHOLE}"),
    ],
)
def test_arguments_of_a_batch_that_cannot_be(settings, message):
    with pytest.raises(PwmGymError, match=message):
        ModelVectorEnv(**{"num_envs": 2, **settings})


@pytest.mark.parametrize("seed", [-1, 2**64, 1.5, "7", True])
@pytest.mark.parametrize("kind", ["env", "sim"])
def test_seeds_that_cannot_be(kind, seed, request):
    env = request.getfixturevalue(kind)
    with pytest.raises(PwmGymError, match=rf"seed={seed!r}; {SEED}"):
        env.unwrapped.reset(seed=seed)


@pytest.mark.parametrize("seed", [-1, [1.5, 2], [3, -2], "ab"])
def test_seeds_of_a_batch_that_cannot_be(seed):
    env = gym.make_vec(**BATCH)
    with pytest.raises(PwmGymError, match=f"seed=.*; {SEED}"):
        env.reset(seed=seed)
    env.reset(seed=np.int64(3))
    env.reset(seed=np.array([3, 4]))
    env.reset(seed=[3, None])


@pytest.mark.parametrize("kind", ["env", "sim"])
def test_options_are_a_dict(kind, request):
    with pytest.raises(PwmGymError, match="options is a int; expected a dict"):
        request.getfixturevalue(kind).unwrapped.reset(options=5)


def test_ragged_actions_and_values_just_outside():
    env = gym.make_vec(**BATCH)
    env.reset(seed=0)
    with pytest.raises(PwmGymError, match=r"actions are ragged; expected an array of shape \(2, 7\)"):
        env.step([[0.0] * 7, [0.0] * 6])
    with pytest.raises(PwmGymError, match="actions hold -1.0001; expected"):
        env.step(np.full((2, 7), -1.0001, np.float32))


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        (lambda points, info: int("x"), r"cost '<lambda>' \(<lambda>\) failed: ValueError: invalid literal"),
        (lambda points, info: points["cube"].mean((1, 2)) * 1j, "returned torch.complex64; expected real values"),
    ],
)
def test_a_cost_that_fails_is_named(env, cost, message):
    env.unwrapped.set_cost(cost)
    with pytest.raises(PwmGymError, match=message):
        env.reset(seed=0)


def test_only_functions_are_registered_as_costs(costs):
    with pytest.raises(PwmGymError, match="cost 'three' is 3; expected a function"):
        pwm_gym.register_cost("three")(3)
    assert "three" not in costs


def test_a_closed_twin_says_so():
    env = gym.make("pwm/PickCubeSim-v0")
    env.reset(seed=0)
    env.close()
    for again in (lambda: env.step(np.zeros(7, np.float32)), lambda: env.reset(seed=0)):
        with pytest.raises(PwmGymError, match="the twin of PickCube is closed; make another one"):
            again()
