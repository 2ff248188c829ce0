import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.data.partial import PartialView
from pwm_gym.dynamics import rollout
from pwm_gym.errors import PwmGymError
from pwm_gym.planning import Agent, MPPIConfig, execute
from pwm_gym.scene import batch_state
from pwm_gym.sim.model import SimulatorModel
from pwm_gym.tasks import get_task

TASK = get_task("PickYCB")
OBJECT = TASK.layout.index("object")
TWO = ("shape_ball", "shape_bar")


@pytest.fixture(scope="module")
def twin(only_shapes):
    env = gym.make("pwm/PickYCBSim-v0", objects=TWO)
    yield env
    env.close()


@pytest.fixture(scope="module")
def seeds(twin):
    """Object -> a seed that draws it."""
    found = {}
    for seed in range(300_000, 300_020):
        twin.reset(seed=seed)
        found.setdefault(twin.unwrapped.scene().assets[OBJECT], seed)
    return {name: found[name] for name in TWO}


@pytest.fixture(scope="module")
def model(only_shapes):
    """Steps a simulator whose own episodes have another object than the twin's."""
    simulator = TASK.make_simulator("shape_box")
    yield SimulatorModel(simulator, TASK.layout, TASK.name, TASK.goal_size)
    simulator.close()


def test_each_episode_is_planned_with_its_own_object(twin, seeds, model):
    agent = Agent(model, TASK.name, MPPIConfig(samples=4, elites=2, horizon=2))
    view = PartialView(twin.unwrapped.simulator.meshes(), TASK.layout)  # whose clouds are no asset's
    for seed, observe in zip(seeds.values(), (None, view), strict=True):
        run = execute(twin, agent, seed, 3, observe=observe)
        np.testing.assert_allclose(run.predicted, run.poses[1:], atol=1e-3)


def test_states_of_several_objects_are_stepped_at_once(twin, seeds, model, random_actions):
    scenes = []
    for seed in seeds.values():
        twin.reset(seed=seed)
        scenes.append(twin.unwrapped.scene())
    actions = 0.3 * random_actions(0, 2, 5, 7)
    model.meet(scenes)
    end = rollout(model, batch_state(scenes), torch.as_tensor(actions))[:, -1].poses()
    for b, scene in enumerate(scenes):
        twin.reset(options={"scene": scene})
        for action in actions[b]:
            twin.step(action)
        truth = batch_state([twin.unwrapped.scene()]).poses()[0]
        assert (end[b] - truth).abs().max() < 1e-3
    other = twin.unwrapped.scene()
    model.meet([other])
    coarse = batch_state([other]).coarsen(TASK.layout.truncate(8))
    assert rollout(model, coarse, torch.as_tensor(actions[:1])).batch == (1, 5)
    with pytest.raises(PwmGymError, match="of no scene that the simulator met, and the objects of PickYCB differ"):
        rollout(model, batch_state(scenes[:1]), torch.as_tensor(actions[:1]))
