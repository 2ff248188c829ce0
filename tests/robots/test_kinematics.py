import pytest
import torch

from pwm_gym.robots import ArmKinematics
from pwm_gym.scene.se3 import motion_vector, rotation_from_vector
from pwm_gym.tasks import get_task

CONTROL = get_task("PickCube").control
ARM = CONTROL.arms[0].chain


@pytest.fixture
def kinematics():
    return ArmKinematics(ARM)


def angles(count, spread=0.3, seed=0):
    """Joint angles (count, 7) around the usual ones."""
    noise = torch.randn(count, 7, generator=torch.Generator().manual_seed(seed))
    return torch.tensor(ARM.rest) + spread * noise


def test_agrees_with_a_general_library_on_the_simulators_urdf(kinematics):
    pk = pytest.importorskip("pytorch_kinematics")
    mani_skill = pytest.importorskip("mani_skill")
    urdf = (mani_skill.PACKAGE_ASSET_DIR / "robots/panda/panda_v2.urdf").read_bytes()
    chain = pk.build_serial_chain_from_urdf(urdf, "panda_hand")
    joints = angles(20)
    expected = chain.forward_kinematics(joints).get_matrix()
    torch.testing.assert_close(kinematics(joints), expected, atol=1e-5, rtol=0)
    frames = kinematics.frames(joints)
    point = kinematics(joints)[:, :3, 3]
    torch.testing.assert_close(kinematics.jacobian(frames, point), chain.jacobian(joints), atol=1e-5, rtol=0)
    lower, upper = chain.get_joint_limits()
    assert (lower, upper) == (pytest.approx(ARM.lower), pytest.approx(ARM.upper))


def test_agrees_with_the_simulators_links(kinematics, train_split):
    for episode in train_split.episodes:
        hand = torch.as_tensor(episode.poses[:, 0])
        root = kinematics(torch.as_tensor(episode.joints[:, 0, :7]))
        torch.testing.assert_close(root[:, :3, 3], hand[:, :3], atol=1e-5, rtol=0)


def test_solves_for_a_pose_near_by(kinematics):
    start = angles(50)
    goal = kinematics(start + 0.1 * torch.randn(50, 7, generator=torch.Generator().manual_seed(1)))
    found, miss = kinematics.solve(goal, start)
    torch.testing.assert_close(kinematics(found), goal, atol=1e-4, rtol=0)
    assert miss.max() < 1e-4
    assert (found - start).norm(dim=1).max() < 0.7  # and stays near where it began


def test_whole_steps_square_the_error(kinematics):
    start = angles(50)
    goal = kinematics(start + 0.1 * torch.randn(50, 7, generator=torch.Generator().manual_seed(1)))
    for count in (2, 3, 4):
        found, before, step = kinematics.approach(goal, start, count)
        previous, earlier = kinematics.solve(goal, start, count - 1)
        _, miss = kinematics.solve(goal, found, 0)
        torch.testing.assert_close(before, earlier)
        torch.testing.assert_close(step, (found - previous).norm(dim=-1), atol=1e-6, rtol=0)
        assert (miss < 0.5 * step.square() + 1e-6).all()


def test_tells_by_how_much_a_goal_out_of_reach_is_missed(kinematics):
    start = angles(3)
    goal = kinematics(start)
    goal[:, 0, 3] += 2.0
    _, miss = kinematics.solve(goal, start, 20)
    assert (miss > 0.5).all()


def test_a_target_is_a_change_of_the_tools_pose(kinematics):
    joints, still = angles(4), torch.zeros(4, 3)
    hand = kinematics(joints)
    torch.testing.assert_close(kinematics.target(hand, still, still), hand, atol=1e-6, rtol=0)
    torch.testing.assert_close(kinematics.target(hand, still, None), hand, atol=1e-6, rtol=0)
    moved = kinematics.target(hand, torch.tensor([[0.05, 0, 0]]).expand(4, 3), None) - hand
    torch.testing.assert_close(moved[:, :3, 3], torch.tensor([[0.05, 0, 0]]).expand(4, 3), atol=1e-6, rtol=0)
    assert moved[:, :3, :3].abs().max() < 1e-6
    before, after = hand, kinematics.target(hand, still, torch.tensor([[-0.06, 0.0, -0.08]]).expand(4, 3))
    turn = after[:, :3, :3] @ before[:, :3, :3].transpose(1, 2)
    expected = rotation_from_vector(torch.tensor([-0.06, 0, 0])) @ rotation_from_vector(torch.tensor([0, 0, -0.08]))
    torch.testing.assert_close(turn, expected.expand(4, 3, 3), atol=1e-6, rtol=0)
    tool = torch.tensor(ARM.tool)
    torch.testing.assert_close(
        before[:, :3, :3] @ tool + before[:, :3, 3], after[:, :3, :3] @ tool + after[:, :3, 3], atol=1e-6, rtol=0
    )


def test_leading_dimensions_and_gradients(kinematics):
    joints = angles(6).view(2, 3, 7).requires_grad_()
    root = kinematics(joints)
    assert root.shape == (2, 3, 4, 4)
    root[..., :3, 3].sum().backward()
    assert joints.grad.abs().sum() > 0
    turn = motion_vector(root[..., :3, :3] @ root[..., :3, :3].transpose(-1, -2))
    assert turn.abs().max() < 1e-6
    assert torch.equal(kinematics.limit(torch.full((7,), 9.0)), kinematics.upper)
