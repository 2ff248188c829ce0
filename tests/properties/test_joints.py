"""Joints: kinematics there and back, limits, and joints that follow others."""

import math

import torch
from hypothesis import given
from hypothesis import strategies as st
from synthetic import hung

from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Joint, Layout, Mimic
from pwm_gym.scene.se3 import inverse, make_pose, rotation_from_vector

numbers = st.floats(-1, 1)
vectors = st.tuples(numbers, numbers, numbers)


@st.composite
def units(draw, size):
    """Unit vectors."""
    found = torch.tensor(draw(st.tuples(*[numbers] * size)), dtype=torch.float64)
    length = float(found.norm())
    return tuple((found / length).tolist()) if length > 0.1 else (1.0, *[0.0] * (size - 1))


@st.composite
def joints(draw, parent):
    """A joint on ``parent``."""
    kind = draw(st.sampled_from(["prismatic", "revolute"]))
    lower = draw(st.floats(-2, 1))
    origin = (*draw(vectors), *draw(units(4)))
    return Joint(kind, parent, origin, draw(units(3)), lower, lower + draw(st.floats(0.01, 2)))


@st.composite
def trees(draw):
    """Entities that hang on each other, the first on the world."""
    count = draw(st.integers(1, 4))
    names = [f"part {k}" for k in range(count)]
    hanging = {}
    for k, name in enumerate(names):
        parent = draw(st.sampled_from([None, *names[:k]]))
        hanging[name] = draw(joints(parent))
    layout = Layout.build([(name, 1) for name in names], joints=hanging)
    return JointTree(layout, range(count)), [hanging[name] for name in names]


@st.composite
def placed(draw):
    """A tree and positions within its limits."""
    tree, every = draw(trees())
    shares = [draw(st.floats(0, 1)) for _ in every]
    positions = [j.lower + share * (j.upper - j.lower) for j, share in zip(every, shares, strict=True)]
    return tree, every, torch.tensor(positions)


def poses_at(tree, positions):
    return tree.place(torch.eye(4).expand(len(tree), 4, 4), positions)


@given(placed())
def test_positions_survive_the_poses_that_they_make(case):
    tree, _, positions = case
    found = tree.positions(poses_at(tree, positions))
    torch.testing.assert_close(found, positions, atol=2e-4, rtol=0)


@given(placed())
def test_poses_are_those_of_the_plain_formula(case):
    tree, every, positions = case
    poses = poses_at(tree, positions)
    for k, joint in enumerate(every):
        parent = torch.eye(4) if tree.parents[k] is None else poses[tree.parents[k]]
        expected = parent @ hung(joint, positions[k].numpy())
        torch.testing.assert_close(poses[k], expected, atol=1e-5, rtol=0)


@given(placed(), vectors, vectors)
def test_positions_do_not_depend_on_where_the_whole_tree_is(case, turn, way):
    tree, every, positions = case
    moved = make_pose(rotation_from_vector(torch.tensor(turn)), torch.tensor(way))
    roots = [k for k, joint in enumerate(every) if joint.parent is None]
    found = tree.positions(moved @ poses_at(tree, positions))
    below = [k for k in range(len(tree)) if k not in roots]
    torch.testing.assert_close(found[below], positions[below], atol=5e-4, rtol=0)


@given(trees(), st.lists(st.floats(-10, 10), min_size=4, max_size=4))
def test_limits_hold_and_are_kept(case, values):
    tree, every = case
    asked = torch.tensor(values[: len(tree)])
    found = tree.limit(asked)
    for value, joint, before in zip(found.tolist(), every, asked.tolist(), strict=True):
        assert joint.lower - 1e-5 <= value <= joint.upper + 1e-5
        if joint.lower <= before <= joint.upper:
            assert math.isclose(value, before, abs_tol=1e-6)
    torch.testing.assert_close(tree.limit(found), found, atol=0, rtol=0)


@given(st.floats(-2, 2), st.floats(-0.5, 0.5), st.floats(-3, 3))
def test_what_follows_another_joint_is_where_that_puts_it(multiplier, offset, value):
    leader = Joint("prismatic", lower=-1.0, upper=1.0)
    follower = Joint("prismatic", lower=-0.8, upper=0.8, mimic=Mimic("leader", multiplier, offset))
    layout = Layout.build([("leader", 1), ("follower", 1)], joints={"leader": leader, "follower": follower})
    tree = JointTree(layout, [0, 1])
    one, other = tree.limit(torch.tensor([value, 123.0])).tolist()
    assert math.isclose(one, min(max(value, -1.0), 1.0), abs_tol=1e-6)
    assert math.isclose(other, min(max(multiplier * value + offset, -0.8), 0.8), abs_tol=1e-5)


@given(placed(), st.integers(-3, 3))
def test_an_angle_is_told_within_a_turn_of_its_limits(case, turns):
    tree, _, positions = case
    whole = positions + 2 * math.pi * turns * tree.revolute
    found = tree.positions(poses_at(tree, whole))
    torch.testing.assert_close(found, positions, atol=5e-4, rtol=0)
    assert float(tree.between(positions, whole)[tree.revolute].abs().sum()) < 1e-3


@given(placed())
def test_a_batch_is_its_elements(case):
    tree, every, positions = case
    upper = torch.tensor([j.upper for j in every])
    both = torch.stack([positions, upper])
    poses = tree.place(torch.eye(4).expand(2, len(tree), 4, 4), both)
    for k, alone in enumerate((positions, upper)):
        torch.testing.assert_close(poses[k], poses_at(tree, alone), atol=1e-6, rtol=0)
    torch.testing.assert_close(inverse(poses) @ poses, torch.eye(4).expand_as(poses), atol=1e-5, rtol=0)
