from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import FIXED, Joint, Layout, Mimic
from pwm_gym.scene.se3 import make_pose, rotation_from_vector

HINGE = Joint("revolute", "base", (0.1, 0.2, 0.3, 0.5, -0.5, 0.5, 0.5), (0.6, 0.0, 0.8), -2.0, 2.5)
SLIDE = Joint("prismatic", "base", (0.3, 0.0, -0.1, 0.0, 0.6, 0.8, 0.0), (0.0, -1.0, 0.0), -0.1, 0.3)
JOINTS = {
    "chain end": replace(SLIDE, parent="hinge"),  # before what it hangs on
    "base": FIXED,
    "hinge": HINGE,
    "slide": SLIDE,
    "door": replace(HINGE, parent=None, axis=(0.0, 0.0, 1.0)),
    "rail": replace(SLIDE, parent=None),
    "ball": Joint(),
    "on ball": replace(HINGE, parent="ball", axis=(1.0, 0.0, 0.0)),
}
LAYOUT = Layout.build([(name, 3) for name in JOINTS], joints=JOINTS)
MOVING = [LAYOUT.index(n) for n in ("hinge", "chain end", "slide", "door", "rail", "on ball")]


def poses_of(*batch, seed=0):
    """Any poses (*batch, E, 4, 4)."""
    count = int(np.prod((*batch, len(LAYOUT))))
    turns = torch.as_tensor(Rotation.random(count, rng=seed).as_matrix()).float().view(*batch, len(LAYOUT), 3, 3)
    return make_pose(turns, torch.randn(*batch, len(LAYOUT), 3, generator=torch.Generator().manual_seed(seed)))


def positions_of(*batch, seed=0):
    tree = JointTree(LAYOUT, MOVING)
    share = torch.rand(*batch, len(MOVING), generator=torch.Generator().manual_seed(seed))
    return tree.lower + share * (tree.upper - tree.lower)


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_positions_of_placed_entities_are_those_given(batch):
    tree, q = JointTree(LAYOUT, MOVING), positions_of(*batch)
    placed = tree.place(poses_of(*batch), q)
    torch.testing.assert_close(tree.positions(placed), q, atol=1e-5, rtol=0)
    rest = [i for i in range(len(LAYOUT)) if i not in MOVING]
    assert torch.equal(placed[..., rest, :, :], poses_of(*batch)[..., rest, :, :])


def test_agrees_with_the_plain_formula():
    tree, q, poses = JointTree(LAYOUT, MOVING), positions_of(4), poses_of(4)
    placed = tree.place(poses, q).double().numpy()
    for b in range(4):
        found = {name: poses[b, i].double().numpy() for i, name in enumerate(LAYOUT.names)}
        for k, i in enumerate(MOVING):  # parents come first
            joint, turn, shift = LAYOUT.entities[i].joint, np.eye(4), np.eye(4)
            turn[:3, :3] = Rotation.from_quat(joint.origin[3:], scalar_first=True).as_matrix()
            turn[:3, 3] = joint.origin[:3]
            if joint.kind == "revolute":
                shift[:3, :3] = Rotation.from_rotvec(float(q[b, k]) * np.array(joint.axis)).as_matrix()
            else:
                shift[:3, 3] = float(q[b, k]) * np.array(joint.axis)
            parent = np.eye(4) if joint.parent is None else found[joint.parent]
            found[LAYOUT.names[i]] = parent @ turn @ shift
        for i, name in enumerate(LAYOUT.names):
            np.testing.assert_allclose(placed[b, i], found[name], atol=1e-5)


def test_sliding_entities_turn_with_their_parents_and_hinges_stay_in_their_anchors():
    tree = JointTree(LAYOUT, MOVING)
    a, b = (tree.place(poses_of(3), positions_of(3, seed=s)) for s in (1, 2))
    slide, hinge, base = (LAYOUT.index(n) for n in ("slide", "hinge", "base"))
    torch.testing.assert_close(a[:, slide, :3, :3], b[:, slide, :3, :3])
    torch.testing.assert_close(a[:, hinge, :3, 3], b[:, hinge, :3, 3])
    assert torch.equal(a[:, base], b[:, base])
    assert (a - b)[:, slide, :3, 3].abs().max() > 0.01 and (a - b)[:, hinge, :3, :3].abs().max() > 0.1


def test_positions_read_off_the_joint_are_the_nearest():
    """Entities that are not quite on their joints: what is across the axis does not count."""
    tree, q = JointTree(LAYOUT, MOVING), positions_of(2)
    placed = tree.place(poses_of(2), q)
    rail = LAYOUT.index("rail")
    across = placed[:, rail, :3, 0] * 0.01  # its axis is its own y
    placed[:, rail, :3, 3] += across
    torch.testing.assert_close(tree.positions(placed)[:, MOVING.index(rail)], q[:, MOVING.index(rail)])


def test_limits_are_kept():
    tree = JointTree(LAYOUT, MOVING)
    far = torch.full((2, len(MOVING)), 9.0)
    assert torch.equal(tree.limit(far), tree.upper.expand(2, -1))
    assert torch.equal(tree.limit(-far), tree.lower.expand(2, -1))
    q = positions_of(4)
    assert torch.equal(tree.limit(q), q)


def test_a_joint_follows_another_within_its_own_limits():
    follower = replace(HINGE, mimic=Mimic("hinge", -0.5, 0.1), lower=-0.4, upper=2.0)
    layout = Layout.build(
        [("follower", 3), ("base", 3), ("hinge", 3)], joints={"base": FIXED, "hinge": HINGE, "follower": follower}
    )
    tree = JointTree(layout, [0, 2])
    found = tree.limit(torch.tensor([[7.0, 0.6], [7.0, -1.0], [0.0, 2.0]]))
    torch.testing.assert_close(found, torch.tensor([[-0.2, 0.6], [0.6, -1.0], [-0.4, 2.0]]))


def test_gradients_are_right():
    tree = JointTree(LAYOUT, MOVING).double()
    poses = poses_of(2).double()
    q = positions_of(2).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda x: tree.place(poses, x), (q,))
    placed = tree.place(poses, q)
    (slope,) = torch.autograd.grad(tree.positions(placed).sum(), q)
    torch.testing.assert_close(slope, torch.ones_like(q))


def test_no_joints_are_no_trouble():
    tree, poses = JointTree(LAYOUT, []), poses_of(3)
    assert len(tree) == 0
    assert tree.positions(poses).shape == (3, 0)
    assert tree.limit(tree.positions(poses)).shape == (3, 0)
    assert tree.place(poses, torch.zeros(3, 0)) is poses


def test_what_is_attached_keeps_its_place_on_what_moves():
    joints = {**JOINTS, "plate": Joint("fixed", "knob"), "knob": Joint("fixed", "hinge")}
    layout = Layout.build([("plate", 3), *((name, 3) for name in JOINTS), ("knob", 3)], joints=joints)
    assert [layout.names[i] for i in layout.attached] == ["plate", "knob"]
    moving = [layout.index(LAYOUT.names[i]) for i in MOVING]
    tree = JointTree(layout, moving, layout.attached)
    turns = torch.as_tensor(Rotation.random(3 * len(layout), rng=1).as_matrix()).float().view(3, -1, 3, 3)
    start = tree.place(make_pose(turns, turns[..., 0]), positions_of(3))
    plate, knob, hinge = (layout.index(n) for n in ("plate", "knob", "hinge"))

    def relative(poses):
        on = torch.linalg.inv(poses[:, hinge])
        return on @ poses[:, knob], on @ poses[:, plate]

    later = tree.place(start, positions_of(3) + 0.3, start)
    assert (later - start)[:, plate].abs().max() > 0.05
    for a, b in zip(relative(later), relative(start), strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=0)
    still = tree.place(later, tree.positions(later), later)
    torch.testing.assert_close(still, later, atol=1e-6, rtol=0)


def test_what_is_attached_stays_rigid_for_thousands_of_steps():
    layout = Layout.build([("body", 3), ("part", 3)], joints={"part": Joint("fixed", "body")})
    tree = JointTree(layout, [], layout.attached)
    pose = make_pose(torch.eye(3) * 1.0001, torch.zeros(3))  # not quite a rotation
    poses = torch.stack([pose, make_pose(torch.eye(3), torch.tensor([0.1, 0.0, 0.0]))])
    turn = make_pose(rotation_from_vector(torch.tensor([0.01, -0.02, 0.005])), torch.zeros(3))
    for _ in range(3000):
        moved = torch.stack([turn @ poses[0], poses[1]])
        poses = tree.place(moved, torch.zeros(0), poses)
    assert poses[1, :3, 3].norm() == pytest.approx(0.1, abs=1e-3)
    torch.testing.assert_close(poses[1, :3, :3] @ poses[1, :3, :3].T, torch.eye(3), atol=1e-3, rtol=0)


def test_a_hinge_beyond_half_a_turn_is_told_from_one_that_is_a_turn_back():
    wide = {"crank": Joint("revolute", axis=(0.0, 0.0, 1.0), lower=-0.5, upper=4.0)}
    tree = JointTree(Layout.build([("crank", 3)], joints=wide), [0])
    q = torch.tensor([[-0.4], [1.0], [3.0], [3.9]])
    placed = tree.place(torch.eye(4).expand(4, 1, 4, 4), q)
    torch.testing.assert_close(tree.positions(placed), q, atol=1e-5, rtol=0)


def test_the_way_between_two_angles_is_the_shorter_one():
    joints = {"wheel": Joint("revolute", lower=-10.0, upper=10.0), "rail": Joint("prismatic", lower=-9.0, upper=9.0)}
    tree = JointTree(Layout.build([(name, 3) for name in joints], joints=joints), [0, 1])
    before, after = torch.tensor([3.1, -4.0]), torch.tensor([-3.1, 4.0])
    torch.testing.assert_close(tree.between(before, after), torch.tensor([2 * np.pi - 6.2, 8.0]).float())
