"""A model whose predictions are not finite ends the episode, and says so."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.envs.common import outside
from pwm_gym.errors import SceneError
from pwm_gym.planning import Agent, MPPIConfig
from pwm_gym.scene import PointState, RigidState

ZERO = np.zeros(7, np.float32)


class Broken:
    """A world model that stands still and spoils a tensor of the state."""

    def __init__(self, model, spoil):
        self.links, self.action_size, self._model, self._spoil = model.links, model.action_size, model, spoil

    def prepare(self, state):
        return self._model.prepare(state)

    def step(self, state, action):
        return self._spoil(state.advance(state.poses(), state.joints, state.error))


def _with_nan(value):
    value = value.clone()
    value[0].flatten()[-1] = torch.nan
    return value


SPOIL = {
    "pose": lambda s: replace(s, frames=_with_nan(s.frames)),
    "joints": lambda s: replace(s, joints=_with_nan(s.joints)),
    "error": lambda s: replace(s, error=_with_nan(s.error)),
    "infinite": lambda s: replace(s, frames=s.frames * torch.inf),
}


@pytest.mark.parametrize("what", SPOIL)
def test_a_prediction_that_is_not_finite_truncates(env, what):
    env.unwrapped.vector.model = Broken(env.unwrapped.model, SPOIL[what])
    env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(ZERO)
    assert truncated and not terminated and info["reason"] == "left the bounds"
    assert observation in env.observation_space and np.isfinite(reward)


def test_points_that_are_not_finite_truncate(env):
    class Points(Broken):
        def prepare(self, state):
            return PointState.of(state)

        def step(self, state, action):
            return state.advance(state.points() * torch.nan)

    env.unwrapped.vector.model = Points(env.unwrapped.model, None)
    env.reset(seed=0)
    observation, _, _, truncated, info = env.step(ZERO)
    assert truncated and info["reason"] == "left the bounds" and observation in env.observation_space


def test_weights_that_are_not_finite_truncate(env):
    model = env.unwrapped.model
    env.reset(seed=0)
    with torch.no_grad():
        for weight in model.parameters():
            weight.fill_(torch.nan)
    observation, _, _, truncated, info = env.step(ZERO)
    assert truncated and info["reason"] == "left the bounds" and observation in env.observation_space


def test_neighbours_go_on():
    env = gym.make_vec("pwm/PickCube-v0", num_envs=2, autoreset_mode="Disabled")
    env.reset(seed=0)
    base = env.unwrapped
    base.model = Broken(base.model, SPOIL["joints"])
    before = base.state.points()[1].clone()
    *_, truncated, info = env.step(np.zeros((2, 7), np.float32))
    assert truncated.tolist() == [True, False] and info["reason"].tolist() == ["left the bounds", ""]
    assert torch.equal(base.state.points()[1], before)


@pytest.mark.parametrize("form", [lambda s: s, PointState.of], ids=["rigid", "points"])
def test_what_is_outside(env, form):
    env.reset(seed=0)
    state = env.unwrapped.state
    assert not outside(form(state)).any()
    frames = state.frames.clone()
    frames[:, 0, 3, 0, 3] = 2.5
    assert outside(form(RigidState(state.layout, state.clouds, frames))).all()


@pytest.mark.parametrize("field", ["clouds", "poses", "goal", "joints", "last_action"])
def test_an_agent_refuses_a_scene_that_is_not_finite(env, scene, field):
    agent = Agent(env.unwrapped.model, "PickCube", MPPIConfig(samples=8, elites=2, horizon=2))
    with pytest.raises(SceneError, match=rf"scene.{field} .*(not finite|finite values)"):
        agent.plan(replace(scene, **{field: getattr(scene, field) * np.nan}))
