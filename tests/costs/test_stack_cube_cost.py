from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.costs import contacts, cost_info, get_cost, get_grasp, get_success
from pwm_gym.scene import Scene, batch_state, sample_clouds
from pwm_gym.tasks import get_task

TASK = get_task("StackCube")


class Episode:
    """An expert's episode, 8 steps past its success, as costs read it, and what the simulator said."""

    def __init__(self, simulator, clouds, seed):
        simulator.reset(seed)
        expert = TASK.expert(np.random.default_rng(seed))
        poses, actions, scenes, outcomes = [simulator.poses()] * 3, [], [], []
        while sum(o.success for o in outcomes) < 8 and len(outcomes) < 180:
            actions.append(expert.act(simulator.poses(), simulator.goal()))
            outcomes.append(simulator.step(actions[-1]))
            poses.insert(0, simulator.poses())
            last = np.stack(poses[:3])
            scenes.append(Scene(TASK.name, TASK.layout, clouds, last, simulator.goal(), simulator.joints()))
        self.actions = torch.as_tensor(np.array(actions))
        self.state = batch_state(scenes)
        self.goal = torch.zeros(len(scenes), 0)
        self.points, self.info = cost_info(self.state, self.actions, self.goal, get_grasp(TASK.grasp))
        self.rewards = np.array([o.reward for o in outcomes])
        self.success = np.array([o.success for o in outcomes])
        self.grasped = np.array([o.grasped for o in outcomes])


@pytest.fixture(scope="module")
def episodes(stack_simulator):
    clouds = sample_clouds(stack_simulator.meshes(), TASK.layout, TASK.cloud_seed)
    return [Episode(stack_simulator, clouds, seed) for seed in (5, 6)]


def test_the_cost_is_minus_maniskills_reward(episodes):
    for episode in episodes:
        reward = -get_cost("stack_cube")(episode.points, episode.info).numpy()
        assert np.corrcoef(reward, episode.rewards)[0, 1] > 0.97
        assert np.abs(reward - episode.rewards).mean() < 0.02
        assert reward[-1] == pytest.approx(1.0)


def test_success_and_grasp_are_maniskills(episodes):
    for episode in episodes:
        found = get_success("stack_cube")(episode.points, episode.info).numpy()
        assert episode.success.any() and (found == episode.success).mean() > 0.97
        pinched = contacts.pinched(episode.points, episode.info["action"], "cube_a").numpy()
        assert episode.grasped.any() and (pinched == episode.grasped).mean() > 0.97


def test_the_planning_cost_falls_along_a_demonstration(episodes):
    for episode in episodes:
        cost = get_cost("stack_cube_plan")(episode.points, episode.info).numpy()
        smooth = np.convolve(cost, np.ones(10) / 10, "valid")[::10]
        assert (np.diff(smooth) < 0.1).all(), smooth.round(2)
        held = np.flatnonzero(episode.grasped)
        before, after = cost[: held[0]], cost[held[-1] + 2 :]
        assert before.min() > cost[held].max() > after.max()  # grasping pays, letting go on top pays more
        assert after.max() < cost[held].min() - 2.0


MOVED = ("hand", "left_gripper", "right_gripper", "cube_a")


def changed(episode, step, action=None, **offsets):
    """What costs read of one step, standing still, with entities moved by (3,) metres, and perhaps another action."""
    state = episode.state[step : step + 1]
    poses = state.frames[:, :1].repeat(1, 3, 1, 1, 1)
    for name, offset in offsets.items():
        poses[:, :, TASK.layout.index(name), :3, 3] += torch.as_tensor(offset)
    command = episode.actions[step : step + 1] if action is None else torch.tensor([action])
    return cost_info(replace(state, frames=poses), command, episode.goal[:1], get_grasp(TASK.grasp))


def onto(episode, step, beside=0.0, height=0.0):
    """Offsets that bring the held cube ``beside`` and ``height`` metres of its place."""
    a, b = (episode.state.frames[step, 0, TASK.layout.index(name), :3, 3] for name in ("cube_a", "cube_b"))
    place = b - a + torch.tensor([beside, 0.0, 0.04 + height])
    return dict.fromkeys(MOVED, place)


def test_letting_go_pays_on_top_of_the_other_cube_alone(episodes):
    episode = episodes[0]
    cost = get_cost("stack_cube_plan")
    step = int(np.flatnonzero(episode.grasped)[-8])  # a firm grasp, wherever it is
    release = [0.0] * 6 + [1.0]

    def costs(beside, height):
        offsets = onto(episode, step, beside, height)
        return cost(*changed(episode, step, **offsets)).item(), cost(*changed(episode, step, release, **offsets)).item()

    holding, released = costs(0.0, 0.0)
    assert released < holding - 0.5
    for beside, height in [(0.0, 0.01), (0.02, 0.0), (0.1, 0.02), (0.1, -0.04)]:
        holding, released = costs(beside, height)
        assert released > holding + 1.0


def test_the_cube_is_carried_over_the_other_one_not_into_it(episodes):
    """Beside cube B, the carried cube's height counts: low costs more than high, and more than farther away."""
    episode = episodes[0]
    carry = get_cost("stack_cube_plan").terms["carry"][1]
    last = int(np.flatnonzero(episode.grasped)[-1])

    def at(beside, height):
        return carry(*changed(episode, last, **onto(episode, last, beside, height))).item()

    assert at(0.05, 0.02) > at(0.05, 0.0) > at(0.05, -0.02)
    heights = [-0.04, -0.02, 0.0, 0.02]
    assert (np.diff([at(0.15, h) for h in heights]) > 0).all()
    beside = [at(b, max(0.0, 0.02 * min((b - 0.005) / 0.04, 1.0))) for b in (0.15, 0.1, 0.05, 0.03, 0.015, 0.0)]
    assert (np.diff(beside) > 0).all(), beside  # the way from above has no barrier


@pytest.mark.parametrize("name", ["stack_cube", "stack_cube_plan"])
def test_costs_have_finite_gradients(episodes, name):
    episode = episodes[0]
    leaves = {n: episode.points[n].clone().requires_grad_() for n in episode.points}
    get_cost(name)(leaves, episode.info).sum().backward()
    assert leaves["cube_a"].grad.abs().sum() > 0
    assert all(leaf.grad is None or leaf.grad.isfinite().all() for leaf in leaves.values())
