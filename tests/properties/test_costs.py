"""Costs on point clouds: what a scene is worth does not depend on how it is written down."""

from functools import cache

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from pwm_gym.costs import COSTS, cost_info, get_cost, get_grasp, get_success
from pwm_gym.dynamics import load_checkpoint, resolve
from pwm_gym.scene import RigidState, batch_state
from pwm_gym.scene.se3 import make_pose, rotation_from_vector
from pwm_gym.tasks import get_task

BATCH, POINTS = 3, 200
TASKS = ("PickCube", "StackCube", "FetchPush")
NAMES = [(task, getattr(get_task(task), kind)) for task in TASKS for kind in ("cost", "plan_cost")]
ABOUT_THE_VERTICAL = [("PickCube", "pick_cube"), ("StackCube", "stack_cube"), ("FetchPush", "fetch_push")]
seeds = st.integers(0, 2**32 - 1)


@cache
def bank(task):
    return load_checkpoint(resolve("default", task)).bank(task)


def drawn(task, seed):
    """Scenes of a task whose entities were moved about at random, with actions and goals."""
    rng = np.random.default_rng(seed)
    known = get_task(task)
    layout = known.layout.truncate(POINTS)
    scenes = [bank(task).scene(int(k)).coarsen(layout) for k in rng.integers(len(bank(task)), size=BATCH)]
    state = batch_state(scenes)
    vectors = 0.1 * torch.as_tensor(rng.normal(size=(2, BATCH, 3, len(layout), 3)), dtype=torch.float32)
    frames = state.frames.clone()
    frames[..., :3, :3] = rotation_from_vector(vectors[0]) @ frames[..., :3, :3]
    frames[..., :3, 3] += vectors[1]
    joints = None if state.joints is None else 0.01 * torch.randn(state.joints.shape)
    state = RigidState(layout, state.clouds, frames, joints)
    action = torch.as_tensor(rng.uniform(-1, 1, (BATCH, known.action_size)), dtype=torch.float32)
    goal = torch.as_tensor(np.stack([s.goal for s in scenes]), dtype=torch.float32)
    return known, state, action, goal


def terms(known, name, state, action, goal):
    return get_cost(name).evaluate(*cost_info(state, action, goal, get_grasp(known.grasp)))


def same(found, expected, atol=2e-4):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, atol=atol, rtol=0, msg=lambda text, n=name: f"{n}: {text}")


@pytest.mark.parametrize(("task", "name"), NAMES)
@given(seeds)
def test_a_cost_is_finite_and_of_each_scene_alone(task, name, seed):
    known, state, action, goal = drawn(task, seed)
    together = terms(known, name, state, action, goal)
    assert all(value.shape == (BATCH,) and value.isfinite().all() for value in together.values())
    for k in range(BATCH):
        alone = terms(known, name, state.map(lambda x, k=k: x[k : k + 1]), action[k : k + 1], goal[k : k + 1])
        same(alone, {term: value[k : k + 1] for term, value in together.items()})


@pytest.mark.parametrize(("task", "name"), NAMES)
@given(seeds)
def test_the_order_of_an_entitys_points_does_not_matter(task, name, seed):
    known, state, action, goal = drawn(task, seed)
    generator = torch.Generator().manual_seed(seed)
    order = torch.cat([e.start + torch.randperm(e.points, generator=generator) for e in state.layout])
    shuffled = RigidState(state.layout, state.clouds[:, order], state.frames, state.joints)
    same(terms(known, name, shuffled, action, goal), terms(known, name, state, action, goal))


@pytest.mark.parametrize(("task", "name"), ABOUT_THE_VERTICAL)
@given(seeds, st.floats(-3.1, 3.1))
def test_shaped_rewards_and_success_do_not_depend_on_where_north_is(task, name, seed, angle):
    known, state, action, goal = drawn(task, seed)
    turn = make_pose(rotation_from_vector(torch.tensor([0.0, 0.0, angle])), torch.zeros(3))
    turned = RigidState(state.layout, state.clouds, turn @ state.frames, state.joints)
    aim = goal @ turn[:3, :3].T if goal.shape[1] == 3 else goal
    same(terms(known, name, turned, action, aim), terms(known, name, state, action, goal), 1e-3)
    success, grasp = get_success(known.success), get_grasp(known.grasp)
    one, other = (success(*cost_info(s, action, g, grasp)) for s, g in ((state, goal), (turned, aim)))
    assert one.dtype == torch.bool and torch.equal(one, other)


@given(st.lists(st.tuples(st.sampled_from(sorted(COSTS)), st.floats(-3, 3)), min_size=1, max_size=3), seeds)
def test_a_sum_of_costs_is_worth_the_sum(parts, seed):
    parts = [(name, weight) for name, weight in parts if name in ("pick_cube", "pick_cube_plan")]
    if not parts:
        parts = [("pick_cube", 1.0)]
    known, state, action, goal = drawn("PickCube", seed)
    points, info = cost_info(state, action, goal, get_grasp(known.grasp))
    total = get_cost(" + ".join(f"{weight!r} * {name}" for name, weight in parts))(points, info)
    expected = sum(weight * get_cost(name)(points, info) for name, weight in parts)
    torch.testing.assert_close(total, expected, atol=1e-4, rtol=1e-4)
