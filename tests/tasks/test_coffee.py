import gymnasium as gym
import numpy as np
import pytest
import torch
from demonstrating import demonstration, steps_to_success
from gymnasium.utils.env_checker import check_env

from pwm_gym.costs import get_cost, get_grasp, get_success, lids
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import batch_state
from pwm_gym.seeds import seed_range
from pwm_gym.sim.coffee_machine import OPEN_ANGLE
from pwm_gym.tasks import get_task

TASK = get_task("Coffee")
LIMIT = TASK.max_episode_steps
LID = TASK.layout.index("lid")


@pytest.fixture(scope="module")
def episode(coffee_simulator):
    return demonstration(TASK, coffee_simulator, seed_range("test", 1)[0])


def test_the_experts_episode_shuts_the_lid(episode):
    scenes, _, outcomes = episode
    assert outcomes[-1].success and 90 < len(outcomes) < LIMIT
    angles = JointTree(TASK.layout, [LID]).positions(batch_state(scenes).poses())[:, 0]
    assert angles[0] == pytest.approx(OPEN_ANGLE, abs=1e-3) and angles[-1].abs() < 0.09
    assert angles.min() > -0.02 and angles.max() < OPEN_ANGLE + 0.02


def test_the_expert_succeeds_in_another_scene(coffee_simulator):
    assert 90 < steps_to_success(TASK, coffee_simulator, seed_range("validation", 1)[0]) <= LIMIT


@pytest.mark.slow
def test_the_expert_succeeds_in_nearly_every_of_50_episodes(coffee_simulator):
    steps = np.array([steps_to_success(TASK, coffee_simulator, seed) for seed in seed_range("test", 50)])
    assert (steps <= LIMIT).mean() >= 0.9, steps


def test_the_cost_is_minus_the_simulators_reward_and_the_rules_are_its_own(episode):
    _, view, outcomes = episode
    rewards = np.array([o.reward for o in outcomes])
    found = -get_cost(TASK.cost)(*view).numpy()
    assert np.corrcoef(found, rewards)[0, 1] > 0.99 and np.abs(found - rewards).mean() < 0.01
    for rule, key in ((get_success(TASK.success), "success"), (get_grasp(TASK.grasp), "grasped")):
        truth = np.array([getattr(o, key) for o in outcomes])
        assert truth.any() and (rule(*view).numpy() == truth).mean() > 0.97, key


def test_clouds_tell_the_lids_angle(episode):
    scenes, (points, _), _ = episode
    truth = JointTree(TASK.layout, [LID]).positions(batch_state(scenes).poses())[:, 0]
    torch.testing.assert_close(lids.angle(points, lids.COFFEE_LID), truth, atol=np.radians(3.0), rtol=0)


def test_few_points_tell_the_holders_place_to_a_tenth_of_a_millimetre(episode):
    scenes, (points, _), _ = episode
    machine = torch.as_tensor(scenes[0].poses[0, TASK.layout.index("machine")])
    height = lids.COFFEE_LID.holder[1]  # of the middle of what stands in it, on the machine's own axis
    few = {name: cloud[:1, :704] for name, cloud in points.items()}
    place = lids.holder(lids.COFFEE_LID)(few, {})[0]
    torch.testing.assert_close(place, machine[:3].float() + torch.tensor([0.0, 0.0, height]), atol=1e-4, rtol=0)


def test_a_demonstration_goes_through_the_stages_of_the_planning_cost_which_falls_and_has_gradients(episode):
    _, (points, info), outcomes = episode
    cost = get_cost(TASK.plan_cost)
    stage = cost.along(cost.begin(1), points, info, len(outcomes)).squeeze(0)
    assert cost.stage_names == ("place pod at machine", "close lid", "rest", "finished")
    assert [int((stage == k).sum()) > 20 for k in range(2)] == [True] * 2 and stage[-1] == 3
    leaves = {name: points[name].clone().requires_grad_() for name in points}
    values = cost(leaves, {**info, "stage": stage})
    values.sum().backward()
    assert all(leaves[name].grad.isfinite().all() and leaves[name].grad.any() for name in ("lid", "pod", "hand"))
    for k in range(2):
        first, *_, last = values.detach()[stage == k].split(10)
        assert last.mean() < first.mean(), cost.stage_names[k]
    assert values[stage >= 2].max() < values[stage < 2].min()


def test_the_twin_tells_the_stage_and_a_reset_begins_anew():
    with gym.make("pwm/CoffeeSim-v0", disable_env_checker=True) as env:
        base = env.unwrapped
        _, info = base.reset(seed=seed_range("test", 1)[0])
        assert info["stage"] == "place pod at machine"
        expert, told = TASK.expert(np.random.default_rng(0)), []
        while not told or (told[-1] == "place pod at machine" and len(told) < LIMIT):
            *_, info = base.step(expert.act(base.simulator.poses(), base.simulator.goal()))
            told.append(info["stage"])
        assert told[-1] == "close lid"
        assert base.reset(seed=1)[1]["stage"] == "place pod at machine"


@pytest.mark.slow
def test_gymnasiums_checker_is_clean():
    env = gym.make("pwm/CoffeeSim-v0").unwrapped
    check_env(env, skip_render_check=True)
    env.close()


def test_the_twin_is_restored():
    env = gym.make("pwm/CoffeeSim-v0").unwrapped
    first, _ = env.reset(seed=4)
    assert first["points"].shape == (4096, 3)
    scene = env.scene()
    env.reset(seed=5)
    again, _ = env.reset(options={"scene": scene})
    np.testing.assert_allclose(again["points"], first["points"], atol=1e-4)
    env.close()
