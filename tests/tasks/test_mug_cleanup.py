from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from demonstrating import demonstration, steps_to_success
from gymnasium.utils.env_checker import check_env

from pwm_gym.costs import cost_info, drawers, get_cost, get_grasp, get_success
from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.scene import batch_state
from pwm_gym.seeds import seed_range
from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.sim.mugs import MUGS, get_mug
from pwm_gym.skills.mug_grips import fits_body
from pwm_gym.tasks import get_task
from pwm_gym.tasks.mug_cleanup import MugCleanupExpert

TASK = get_task("MugCleanup")
LIMIT = TASK.max_episode_steps
DRAWER = TASK.layout.index("drawer")


@pytest.fixture(scope="module")
def episode(mug_simulator):
    return demonstration(TASK, mug_simulator, seed_range("test", 1)[0])


def true_openings(scenes):
    """Way (T,) of the drawer, as poses tell."""
    poses = np.stack([scene.poses[0] for scene in scenes])
    return np.linalg.norm((poses[:, DRAWER] - poses[:, TASK.layout.index("cabinet")])[:, :2], axis=-1)


def test_the_experts_episode_opens_the_drawer_and_shuts_it(episode):
    scenes, _, outcomes = episode
    assert outcomes[-1].success and 180 < len(outcomes) < 360
    way = true_openings(scenes)
    assert way.max() > 0.14 and way[-1] < 0.008 and way.min() > -1e-3 and way.max() < LOW_CABINET.stroke + 1e-3


@pytest.mark.parametrize(
    ("by_body", "hooked", "seed"),
    [(False, True, seed_range("validation", 1)[0]), (True, False, seed_range("plan_validation", 5)[4])],
)
def test_the_expert_succeeds_with_other_mugs_by_either_grip_and_way_to_open(mug_simulator, by_body, hooked, seed):
    task = replace(TASK, expert=lambda rng: MugCleanupExpert(0.03, by_body, hooked))
    assert 180 < steps_to_success(task, mug_simulator, seed) <= LIMIT
    mug = get_mug(mug_simulator.assets()[TASK.layout.index("mug")])
    assert fits_body(mug) == by_body  # the other mug is too wide for the open gripper


@pytest.mark.slow
def test_the_expert_succeeds_in_nearly_every_of_50_episodes(mug_simulator):
    steps = np.array([steps_to_success(TASK, mug_simulator, seed) for seed in seed_range("test", 50)])
    assert (steps <= LIMIT).mean() >= 0.95, steps


def test_the_expert_goes_on_from_a_restored_scene(mug_simulator, episode):
    scenes, _, outcomes = episode
    inside = next(t for t in range(len(scenes)) if outcomes[t].reward > 5 / 8 and not outcomes[t].grasped)
    mug_simulator.restore(scenes[inside + 10])
    expert = TASK.expert(np.random.default_rng(0))
    steps = (
        mug_simulator.step(expert.act(mug_simulator.poses(), mug_simulator.goal(), mug_simulator.assets()))
        for _ in range(120)
    )
    assert any(outcome.success for outcome in steps)


def test_the_cost_is_minus_the_simulators_reward_and_success_is_its_own(episode):
    _, view, outcomes = episode
    rewards = np.array([o.reward for o in outcomes])
    found = -get_cost(TASK.cost)(*view).numpy()
    assert np.corrcoef(found, rewards)[0, 1] > 0.99 and np.abs(found - rewards).mean() < 0.01
    success = np.array([o.success for o in outcomes])
    assert success.any() and (get_success(TASK.success)(*view).numpy() == success).mean() > 0.99


def test_the_contact_rule_tells_the_simulators_grasps(episode):
    _, view, outcomes = episode
    grasped = np.array([o.grasped for o in outcomes])
    assert grasped.any() and (get_grasp(TASK.grasp)(*view).numpy() == grasped).mean() > 0.97


@pytest.mark.parametrize("points", [8192, 2048])
def test_clouds_tell_how_far_the_drawer_is_open(episode, points):
    scenes, _, _ = episode
    some = [scene.coarsen(TASK.layout.resize(points)) for scene in scenes[::20]]
    view, _ = cost_info(batch_state(some), torch.zeros(len(some), 7), torch.zeros(len(some), 0), get_grasp(TASK.grasp))
    found = drawers.opening(view, drawers.CABINET_DRAWER).numpy()
    np.testing.assert_allclose(found, true_openings(some), atol=2e-3)


def test_a_demonstration_goes_through_the_stages_of_the_planning_cost_which_falls_and_has_gradients(episode):
    _, (points, info), outcomes = episode
    cost = get_cost(TASK.plan_cost)
    stage = cost.along(cost.begin(1), points, info, len(outcomes)).squeeze(0)
    assert cost.stage_names == ("open drawer", "place mug at drawer", "close drawer", "rest", "finished")
    assert [int((stage == k).sum()) > 20 for k in range(3)] == [True] * 3 and stage[-1] == 4
    values = cost(points, {**info, "stage": stage})
    few = {name: points[name][::6].clone().requires_grad_() for name in points}
    told = {key: value[::6] for key, value in info.items() if isinstance(value, torch.Tensor)}
    told["velocity"] = {name: info["velocity"][name][::6] for name in points}
    cost(few, {**told, "stage": stage[::6]}).sum().backward()
    assert all(few[name].grad.isfinite().all() and few[name].grad.any() for name in ("drawer", "mug", "hand"))
    for k in range(3):
        first, *_, last = values[stage == k].split(10)
        assert last.mean() < first.mean(), cost.stage_names[k]
    assert values[stage >= 3].max() < values[stage < 3].min()


@pytest.mark.slow
def test_gymnasiums_checker_is_clean():
    env = gym.make("pwm/MugCleanupSim-v0").unwrapped
    check_env(env, skip_render_check=True)
    env.close()


def test_the_twin_is_restored():
    env = gym.make("pwm/MugCleanupSim-v0").unwrapped
    first, _ = env.reset(seed=4)
    assert first["points"].shape == (8192, 3) and first["goal"].shape == (0,)
    scene = env.scene()
    env.reset(seed=5)
    again, _ = env.reset(options={"scene": scene})
    np.testing.assert_allclose(again["points"], first["points"], atol=1e-4)
    assert env.scene().assets == scene.assets
    env.close()


def test_the_papers_point_count_and_the_layouts_joints():
    assert TASK.layout.points == 8192
    assert TASK.objects == ("drawer", "mug")
    assert [TASK.layout[name].joint.kind for name in ("cabinet", "drawer", "mug")] == ["fixed", "prismatic", "free"]


def test_mugs_are_known_by_name():
    assert len(MUGS) == 9 and get_mug("mug_35x66").radius == 0.035
    with pytest.raises(UnknownNameError, match="unknown mug 'mug_35x65'.*Did you mean 'mug_35x6"):
        get_mug("mug_35x65")
    with pytest.raises(PwmGymError, match="was given no assets"):
        TASK.expert(np.random.default_rng(0)).act(np.zeros((6, 7)), np.zeros(0))
