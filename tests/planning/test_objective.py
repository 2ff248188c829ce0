import numpy as np
import pytest
import torch

from pwm_gym.costs import cost_info, get_cost, get_grasp
from pwm_gym.dynamics import CompactConfig, CompactModel, PaperConfig, PaperModel
from pwm_gym.planning import Agent, MPPIConfig, RolloutObjective
from pwm_gym.scene import batch_state
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
CONTROL = TASK.control
TINY = CompactConfig(points=8, point_width=8, width=16, blocks=1)


@pytest.fixture(scope="module")
def model(train_split):
    torch.manual_seed(0)
    model = CompactModel(TASK.layout, CONTROL, TINY).eval().requires_grad_(False)
    torch.nn.init.normal_(model.movers.head.weight, std=0.2)
    model.robot.arms[0].weight[:7, :7] = 0.4 * torch.eye(7)  # of the way to where the controller drives the joints
    return model


@pytest.fixture
def start(train_split):
    """Two scenes in the middle of episodes, and their goals."""
    scenes = [train_split.scene(train_split.episodes[i], 30) for i in (0, 1)]
    return scenes, batch_state(scenes), torch.as_tensor(np.stack([s.goal for s in scenes]))


@pytest.fixture
def actions():
    return torch.rand(2, 3, 4, 7, generator=torch.Generator().manual_seed(1)) * 2 - 1


def by_hand(model, cost, state, goal, actions):
    """Cost of one action sequence (H, 7) in one scene, step by step: the last step counts three times."""
    total = 0.0
    state = model.prepare(state)
    for k, action in enumerate(actions):
        state = model.step(state, action[None])
        points, info = cost_info(state, action[None], goal, get_grasp("pick_cube"))
        total += (3.0 if k == len(actions) - 1 else 1.0) * cost(points, info).item()
    return total


def assert_same_as_by_hand(model, cost, state, goal, actions):
    found = RolloutObjective(model, cost, get_grasp("pick_cube"), terminal=2.0).begin(state, goal)(actions)
    assert found.shape == (2, 3)
    with torch.no_grad():
        expected = [
            [by_hand(model, cost, state[b : b + 1], goal[b : b + 1], actions[b, s]) for s in range(3)] for b in range(2)
        ]
    torch.testing.assert_close(found, torch.tensor(expected), atol=1e-4, rtol=1e-5)
    assert found.std() > 1e-3


@pytest.mark.parametrize("cost", ["pick_cube", "pick_cube_plan"])
def test_it_is_the_sum_of_costs_of_a_rollout_by_hand(model, start, actions, cost):
    assert_same_as_by_hand(model, get_cost(cost), start[1], start[2], actions)


def test_models_that_move_points_are_planned_with_too(start):
    torch.manual_seed(0)
    small = PaperConfig(
        encoder_depths=(1, 1, 1), encoder_channels=(8, 16, 32), encoder_heads=(2, 2, 4), encoder_patches=(64, 16, 64),
        decoder_depths=(1, 1), decoder_channels=(16, 16), decoder_heads=(2, 2), decoder_patches=(64, 16),
        bottleneck_heads=4, mlp_ratio=2, grid_size=0.01,
    )  # fmt: skip
    layout = TASK.layout.truncate(24)
    model = PaperModel(layout, CONTROL, small).eval()
    torch.nn.init.normal_(model.head[-1].weight, std=0.3)
    state = start[1].coarsen(layout)
    actions = torch.rand(2, 3, 2, 7, generator=torch.Generator().manual_seed(1)) * 2 - 1
    assert_same_as_by_hand(model, get_cost("pick_cube"), state, start[2], actions)


def test_fewer_points_cost_about_the_same(model, start, actions):
    cost, grasp = get_cost("pick_cube"), get_grasp("pick_cube")
    full, coarse = (
        RolloutObjective(model, cost, grasp, points=n).begin(start[1], start[2])(actions) for n in (None, 100)
    )
    assert not torch.equal(full, coarse)
    torch.testing.assert_close(coarse, full, atol=0.1, rtol=0)


def test_costs_of_large_scenes_read_a_part_of_the_points(model, start, actions, monkeypatch):
    read = []

    def cost(points, info):
        read.append(sum(points[name].shape[1] for name in points))
        return points["cube"].mean(-2)[..., 2]

    monkeypatch.setattr("pwm_gym.planning.objective.MOST_POINTS", 400)
    RolloutObjective(model, get_cost(cost), get_grasp("pick_cube")).begin(start[1], start[2])(actions)
    assert read == [400]


def test_an_agent_acts_reproducibly(model, start):
    config = MPPIConfig(samples=16, elites=4, horizon=3)
    agent = Agent(model, "PickCube", config, seed=3)
    agent.reset(5)
    first = agent.act(start[0][0])
    assert first.shape == (7,) and first.dtype == np.float32 and np.abs(first).max() <= 1
    second = agent.act(start[0][0])
    assert not np.array_equal(first, second)  # the noise goes on
    agent.reset(5)
    np.testing.assert_array_equal(agent.act(start[0][0]), first)
    agent.reset(5)
    np.testing.assert_array_equal(agent.plan(start[0][0])[0], first)


def test_an_agent_follows_its_cost(model, start):
    """Under a cost of its own the plan moves the hand the way the cost says."""

    def sideways(sign):
        return lambda points, info: sign * points["hand"].mean(-2)[..., 1]

    config = MPPIConfig(samples=64, elites=8, horizon=4, iterations=3)
    towards = {
        sign: Agent(model, "PickCube", config, sideways(sign)).plan(start[0][0])[:, 1].mean() for sign in (-1, 1)
    }
    assert towards[-1] > 0.3 > -0.3 > towards[1]
