"""Rates of simulators: of the environment that one steps, or of its own."""

import numpy as np
import pytest
from gymnasium import spaces

from pwm_gym.evaluation.benchmarks import _own_rate, simulator_rate
from pwm_gym.sim.mujoco import MujocoSimulator
from pwm_gym.tasks import get_task

SLIDER = """<mujoco><worldbody><body name="block"><joint name="slide" type="slide" axis="1 0 0"/>
<geom type="box" size="0.1 0.1 0.1"/></body></worldbody>
<actuator><position joint="slide" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize("name", ["FetchReach", "AdroitHandDoor"])
def test_the_rate_of_a_robotics_task_is_that_of_its_environment(name):
    simulator = get_task(name).make_simulator()
    assert simulator.env.action_space.shape == (simulator.action_size,)
    simulator.close()
    assert 10.0 < simulator_rate(get_task(name), 0.2) < 1e6


def test_a_model_without_an_environment_is_timed_itself(monkeypatch):
    simulator = MujocoSimulator.from_xml(SLIDER, {"block": "block"})
    assert simulator.env is None
    step, places = simulator.step, []

    def watched(action):
        outcome = step(action)
        places.append(simulator.poses()[0, 0])
        return outcome

    monkeypatch.setattr(simulator, "step", watched)
    actions = spaces.Box(-1.0, 1.0, (1,), np.float32)
    assert 10.0 < _own_rate(simulator, actions, 0.2) < 1e7
    assert np.abs(places).max() > 1e-4  # it was moved
