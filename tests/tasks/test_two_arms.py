"""Both tasks of two arms with hands."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from demonstrating import demonstration, steps_to_success

from pwm_gym.costs import cost_info, get_cost, get_grasp, get_success
from pwm_gym.dynamics import build_model
from pwm_gym.errors import SceneError
from pwm_gym.scene import Layout, batch_state
from pwm_gym.seeds import seed_range
from pwm_gym.tasks import get_task

TASKS = {name: get_task(name) for name in ("TwoArmBoxCleanup", "TwoArmDrawerCleanup")}
LEAST = {"TwoArmBoxCleanup": 0.95, "TwoArmDrawerCleanup": 0.85}  # share of successes of the experts


@pytest.fixture(scope="module", params=TASKS)
def recorded(request):
    """A task, its simulator, and an expert's episode in it."""
    task = TASKS[request.param]
    simulator = task.make_simulator()
    yield task, simulator, demonstration(task, simulator, seed_range("test", 1)[0])
    simulator.close()


def test_the_expert_succeeds_in_about_its_mean_length(recorded):
    task, _, (_, _, outcomes) = recorded
    assert outcomes[-1].success and 0.7 < len(outcomes) / task.expert_steps < 1.4


@pytest.mark.slow
def test_the_expert_succeeds_in_nearly_every_of_50_episodes(recorded):
    task, simulator, _ = recorded
    steps = np.array([steps_to_success(task, simulator, seed) for seed in seed_range("validation", 50)])
    assert (steps <= task.max_episode_steps).mean() >= LEAST[task.name], steps


def test_the_cost_is_minus_the_simulators_reward_and_its_rules_are_the_simulators(recorded):
    task, _, (_, view, outcomes) = recorded
    rewards = np.array([o.reward for o in outcomes])
    found = -get_cost(task.cost)(*view).numpy()
    assert np.corrcoef(found, rewards)[0, 1] > 0.99 and np.abs(found - rewards).mean() < 0.01
    success, grasped = (np.array([getattr(o, key) for o in outcomes]) for key in ("success", "grasped"))
    assert success.any() and (get_success(task.success)(*view).numpy() == success).mean() > 0.99
    assert grasped.any() and (get_grasp(task.grasp)(*view).numpy() == grasped).mean() > 0.97


def test_a_demonstration_goes_through_all_stages_and_their_costs_fall(recorded):
    task, _, (_, (points, info), outcomes) = recorded
    cost = get_cost(task.plan_cost)
    stage = cost.along(cost.begin(1), points, info, len(outcomes)).squeeze(0)
    assert stage[-1] == len(cost.stages) and (stage.diff() >= 0).all()
    values = cost(points, {**info, "stage": stage})
    for k, part in enumerate(cost.stages):
        own = values[stage == k]
        if len(own) > 12:
            assert own[-4:].mean() < own[:4].mean(), part.name
    ends = [values[stage == k].mean() for k in range(len(cost.stages)) if bool((stage == k).any())]
    assert all(later < earlier for earlier, later in pairwise(ends))


def test_hands_that_lose_what_they_carry_begin_anew_where_they_came_to_it(recorded):
    task, _, (scenes, _, outcomes) = recorded
    held = [t for t, outcome in enumerate(outcomes) if outcome.grasped]
    scene, carried = scenes[held[len(held) // 2]], {"TwoArmBoxCleanup": "lid", "TwoArmDrawerCleanup": "mug"}[task.name]
    poses = scene.poses.copy()
    poses[:, scene.layout.index(carried), 0] -= 0.2
    state = batch_state([scene, replace(scene, poses=poses)])
    cost, zeros = get_cost(task.plan_cost), torch.zeros(2, task.action_size)
    points, info = cost_info(state, zeros, torch.zeros(2, task.goal_size), get_grasp(task.grasp))
    carrying = cost.stage_names.index("carry")
    kept, lost = (cost.stage_names[k] for k in cost.advance(torch.tensor([carrying, carrying]), points, info))
    assert kept in ("carry", "lower")
    assert lost == {"TwoArmBoxCleanup": "surround", "TwoArmDrawerCleanup": "reach"}[task.name]


def test_the_expert_goes_on_from_a_restored_scene(recorded):
    task, simulator, (scenes, _, outcomes) = recorded
    held = [t for t, outcome in enumerate(outcomes) if outcome.grasped]
    simulator.restore(scenes[held[len(held) // 2]])
    expert = task.expert(np.random.default_rng(1))
    left = task.max_episode_steps - held[0]
    steps = (simulator.step(expert.act(simulator.poses(), simulator.goal())) for _ in range(left))
    assert any(outcome.success for outcome in steps)


def test_a_world_model_knows_all_links_and_refuses_other_robots(recorded):
    task, _, (scenes, _, _) = recorded
    model = build_model("compact", task.layout, task.control).eval()
    state = model.prepare(batch_state(scenes[:2]))
    after = model.step(state, torch.zeros(2, 24))
    assert after.poses().shape == (2, len(task.layout), 4, 4) and after.joints.shape == (2, 2, 14)
    links = [k for k, e in enumerate(task.layout) if e.driven]
    torch.testing.assert_close(after.poses()[:, links], state.poses()[:, links], atol=0.02, rtol=0)

    def told(layout):
        return replace(batch_state(scenes[:1]), layout=layout)

    single = Layout.build([(e.name, e.points) for e in task.layout], driven=["left_palm"])
    with pytest.raises(SceneError, match="the scene's robot has left_palm; expected left_palm, left_thumb_1"):
        model.prepare(told(single))
    lame = [
        replace(e, joint=replace(e.joint, mimic=None)) if e.name == "right_ring_2" else e for e in task.layout.entities
    ]
    with pytest.raises(SceneError, match="'right_ring_2' follows another rule than the model's: none and 0.8 \\* rig"):
        model.prepare(told(replace(task.layout, entities=tuple(lame))))


@pytest.mark.parametrize(("name", "points"), [("TwoArmBoxCleanup", 10_000), ("TwoArmDrawerCleanup", 12_000)])
def test_the_papers_point_counts(name, points):
    assert TASKS[name].layout.points == points and TASKS[name].action_size == 24
