import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pwm_gym.costs import contacts, cost_info, get_cost, get_grasp, get_success
from pwm_gym.costs.motion import angular_velocity, joint_speed, spin
from pwm_gym.data import KINDS
from pwm_gym.robots.joints import JointTree
from pwm_gym.robots.panda import JOINT_SPEEDS
from pwm_gym.scene import RigidState, batch_state
from pwm_gym.scene.se3 import make_pose
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
HAND, CUBE = TASK.layout.index("hand"), TASK.layout.index("cube")


def view(dataset, episode):
    """What costs read after each action of an episode."""
    state = batch_state([dataset.scene(episode, k + 1) for k in range(len(episode))])
    goal = torch.as_tensor(episode.goal).expand(len(episode), -1)
    return cost_info(state, torch.as_tensor(episode.actions), goal, get_grasp("pick_cube"))


def experts(dataset):
    found = [e for e in dataset.episodes if KINDS[e.kind] == "expert"]
    assert found
    return found


def test_the_cost_is_minus_maniskills_reward_along_expert_episodes(train_split):
    for episode in experts(train_split):
        reward = -get_cost("pick_cube")(*view(train_split, episode)).numpy()
        assert np.corrcoef(reward, episode.rewards)[0, 1] >= 0.98
        assert np.abs(reward - episode.rewards).mean() < 0.02
        assert np.median(np.abs(reward - episode.rewards)) < 0.01


def test_success_is_maniskills(train_split):
    truth, found = [], []
    for episode in train_split.episodes:
        truth.append(episode.success)
        found.append(get_success("pick_cube")(*view(train_split, episode)).numpy())
    truth, found = np.concatenate(truth), np.concatenate(found)
    assert truth.any()
    assert (truth == found).mean() > 0.97


def test_pinched_is_maniskills_grasp_on_expert_episodes(train_split):
    for episode in experts(train_split):
        points, info = view(train_split, episode)
        found = contacts.pinched(points, info["action"], "cube").numpy()
        assert episode.grasped.any()
        assert (found == episode.grasped).mean() > 0.93


def test_pinched_is_maniskills_grasp_on_practice_episodes(train_split):
    practice = [e for e in train_split.episodes if KINDS[e.kind] == "practice"]
    agree = []
    for episode in practice:
        points, info = view(train_split, episode)
        agree.append(contacts.pinched(points, info["action"], "cube").numpy() == episode.grasped)
    assert len(practice) >= 2
    assert np.concatenate(agree).mean() > 0.95


def test_the_joint_speed_is_the_arms_fastest_joints(train_split):
    """Where joints are unknown it is estimated with constants of the task's postures; do they hold?"""
    found, truth = [], []
    for episode in experts(train_split):
        points, info = view(train_split, episode)
        truth.append(joint_speed(points, info, JOINT_SPEEDS).numpy())
        found.append(joint_speed(points, {**info, "joints": None}, JOINT_SPEEDS).numpy())
        np.testing.assert_allclose(truth[-1], 20.0 * np.abs(episode.joints[1:, 1, :7]).max(1), rtol=1e-5)
    found, truth = np.concatenate(found), np.concatenate(truth)
    assert np.corrcoef(found, truth)[0, 1] > 0.95
    assert np.median(np.abs(found - truth)) < 0.04


@pytest.fixture
def grip(train_split):
    """``grip(opening, offset)``: the hand pointing down, its tool centre at ``offset`` from a cube in the air."""
    fingers = JointTree(TASK.layout, [1, 2])
    clouds = torch.as_tensor(train_split.clouds)

    def make(opening, offset):
        down = torch.as_tensor(Rotation.from_rotvec([np.pi, 0, 0]).as_matrix()).float()
        cube = torch.tensor([0.6, 0.0, 0.2])
        root = make_pose(down, cube + torch.tensor(offset) + torch.tensor([0, 0, 0.1034]))[None]
        parts = torch.stack([root, root, root, make_pose(torch.eye(3), cube)[None]], 1)
        poses = fingers.place(parts, torch.full((1, 2), opening))
        state = RigidState(TASK.layout, clouds, poses[:, None].expand(-1, 3, -1, -1, -1))
        shut = torch.tensor([[0.0, 0, 0, 0, 0, 0, -1]])
        return cost_info(state, shut, torch.zeros(1, 3), get_grasp("pick_cube"))

    return make


PRESSED = 0.018  # the pads sink 2 mm into the cube's sides at 20 mm


def test_a_real_grasp_is_pinched(grip):
    points, info = grip(PRESSED, (0.0, 0.0, 0.0))
    assert contacts.pinched(points, info["action"], "cube").item()
    assert info["grasped"].item()
    assert not contacts.pinched(points, -info["action"], "cube").item()  # commanded open


@pytest.mark.parametrize(
    ("opening", "offset"),
    [
        (0.0, (0.0, 0.0, 0.02)),  # shut above the cube
        (PRESSED, (0.0, 0.0, 0.15)),  # at its width, but far above
        (0.0, (0.0, 0.0, 0.0)),  # shut inside it
        (0.04, (0.0, 0.0, 0.0)),  # open around it
        (PRESSED, (0.0, 0.012, 0.0)),  # the cube beside the fingers' middle
    ],
)
def test_pinched_is_not_fooled(grip, opening, offset):
    points, info = grip(opening, offset)
    assert not contacts.pinched(points, info["action"], "cube").item()


@pytest.mark.parametrize(("sideways", "held"), [(0.0, True), (0.026, True), (0.034, False)])
def test_an_edge_of_the_cube_is_pinched_until_the_pads_are_past_it(grip, sideways, held):
    points, info = grip(PRESSED, (sideways, 0.0, 0.0))
    assert contacts.pinched(points, info["action"], "cube").item() == held


def test_a_half_shut_gripper_pinches(grip):
    points, info = grip(0.0195, (0.0, 0.0, 0.0))
    half = torch.zeros_like(info["action"])
    assert contacts.pinched(points, half, "cube").item()
    assert not contacts.near_and_shut(points, half, "cube").item()


def test_the_spin_is_the_turn_about_the_vertical():
    rng = np.random.default_rng(0)
    before = rng.normal(size=(5, 40, 3))
    turns = np.linspace(-0.05, 0.05, 5)
    after = np.stack(
        [p @ Rotation.from_rotvec([0, 0, a]).as_matrix().T + [0.1, 0, 0.2] for p, a in zip(before, turns, strict=True)]
    )
    points, velocity = torch.as_tensor(after), torch.as_tensor(after - before)
    torch.testing.assert_close(
        spin({"hand": points}, {"hand": velocity}, "hand"), torch.as_tensor(turns), atol=1e-3, rtol=0
    )


def test_the_angular_velocity_is_the_turn_about_any_axis():
    rng = np.random.default_rng(0)
    before = rng.normal(size=(4, 40, 3))
    turns = rng.normal(0.0, 0.01, (4, 3))
    after = np.stack(
        [p @ Rotation.from_rotvec(t).as_matrix().T + [0.1, 0, 0.2] for p, t in zip(before, turns, strict=True)]
    )
    points, velocity = {"cube": torch.as_tensor(after)}, {"cube": torch.as_tensor(after - before)}
    found = angular_velocity(points, velocity, "cube").numpy()
    np.testing.assert_allclose(found, turns, atol=5e-4)


def test_shut_above_the_cube_is_near_but_not_pinched_and_pays_nothing(grip):
    fooled, real = grip(0.0, (0.0, 0.0, 0.02)), grip(PRESSED, (0.0, 0.0, 0.0))
    assert contacts.near_and_shut(fooled[0], fooled[1]["action"], "cube").item()
    parts = get_cost("pick_cube").evaluate(*fooled)
    assert parts["contact"].item() == parts["placing"].item() == 0
    plan = get_cost("pick_cube_plan")
    assert plan.evaluate(*real)["premature_close"].item() < 0.5 * plan.evaluate(*fooled)["premature_close"].item()
    assert plan(*real).item() < plan(*fooled).item() - 2


def test_the_tool_centre_is_between_the_finger_tips(grip):
    for opening in (0.0, 0.02, 0.04):
        points, _ = grip(opening, (0.0, 0.0, 0.0))
        gap = contacts.tool_centre(points)[0] - torch.tensor([0.6, 0.0, 0.2])
        assert gap.norm() < 0.003


@pytest.mark.parametrize(("opening", "gap"), [(0.02, 0.0), (0.03, 0.01), (0.015, -0.005)])
def test_finger_gaps_measure_from_pad_to_side(grip, opening, gap):
    gaps = contacts.finger_gaps(grip(opening, (0.0, 0.0, 0.0))[0], "cube")
    torch.testing.assert_close(gaps, torch.full((1, 2), gap), atol=1e-3, rtol=0)


@pytest.mark.parametrize("name", ["pick_cube", "pick_cube_plan"])
def test_costs_have_gradients(grip, name):
    points, info = grip(0.03, (0.01, 0.005, 0.02))
    leaves = {n: points[n].clone().requires_grad_() for n in points}
    get_cost(name)(leaves, info).sum().backward()
    assert leaves["left_gripper"].grad.abs().sum() > 0
    assert all(leaf.grad is None or leaf.grad.isfinite().all() for leaf in leaves.values())


@pytest.mark.parametrize("name", ["pick_cube", "pick_cube_plan"])
def test_a_scenes_cost_does_not_depend_on_its_batch(train_split, name):
    episode = train_split.episodes[0]
    points, info = view(train_split, episode)
    batch = get_cost(name)(points, info)
    state = batch_state([train_split.scene(episode, 21)])
    alone = cost_info(
        state, torch.as_tensor(episode.actions[20:21]), torch.as_tensor(episode.goal[None]), get_grasp("pick_cube")
    )
    torch.testing.assert_close(get_cost(name)(*alone), batch[20:21], atol=1e-5, rtol=0)
