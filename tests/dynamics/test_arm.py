from dataclasses import replace

import pytest
import torch

from pwm_gym.collection.scenes import simulated_bank
from pwm_gym.data import Windows
from pwm_gym.dynamics.compact.arm import ArmResponse
from pwm_gym.dynamics.compact.model import CompactConfig, CompactModel
from pwm_gym.scene import batch_state
from pwm_gym.scene.se3 import make_pose, rotation_from_vector
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
ARM = TASK.control.arms[0]
SMALL = CompactConfig(points=24, point_width=16, width=32, blocks=2, arm_width=32)


@pytest.fixture(scope="module")
def transitions(train_split):
    return Windows(train_split).transitions()


@pytest.fixture(scope="module")
def response(transitions):
    torch.manual_seed(0)
    arm = ArmResponse(ARM, TASK.control, width=32)
    fit(arm, transitions.joints, transitions, steps=200)
    return arm.requires_grad_(False)


def fit(arm, joints, batch, steps):
    arm.fit(joints[..., :7], batch.actions[:, 0], batch.following_joints[:, 0, :, :7], steps, floor=0.0)


def predicted(response, batch):
    joints = batch.joints[..., :7]
    step = response(joints, batch.actions[:, 0], response.kinematics(joints[:, 0]), 0.0).step
    return torch.stack([joints[:, 0] + step[:, 0], step[:, 1]], 1)


def test_the_fitted_joints_go_where_the_simulators_go(response, transitions):
    truth, before = transitions.following_joints[:, 0, :, :7], transitions.joints[..., :7]
    error = (predicted(response, transitions) - truth).norm(dim=-1).mean(0)
    assert error[0] < 0.1 * (truth - before)[:, 0].norm(dim=-1).mean()
    assert error[1] < 0.15 * truth[:, 1].norm(dim=-1).mean()


@pytest.mark.parametrize(("steps", "kinds"), [(0, ("expert", "randomised")), (200, None)])
def test_velocities_tell_what_past_positions_do_not(train_split, steps, kinds):
    """Fitted with and without velocities: least squares alone on demonstrations, the whole response on all."""
    transitions = Windows(train_split.of_kinds(kinds) if kinds else train_split).transitions()
    following = transitions.following_joints[:, 0]
    joints = transitions.joints.clone()
    errors = []
    for known in (joints, torch.stack([joints[:, 0], torch.zeros_like(joints[:, 1])], 1)):
        torch.manual_seed(0)
        arm = ArmResponse(ARM, TASK.control, width=32)
        fit(arm, known, transitions, steps)
        arm.requires_grad_(False)
        hand = arm.kinematics(known[:, 0, :7])
        step = arm(known[..., :7], transitions.actions[:, 0], hand, 0.0).step[:, 0]
        errors.append((known[:, 0, :7] + step - following[:, 0, :7]).norm(dim=-1).mean())
    assert errors[0] < 0.5 * errors[1]


def test_a_command_out_of_reach_leaves_the_arm_where_it_is(response):
    joints = torch.tensor([ARM.chain.rest])
    action = torch.zeros(1, 7)
    action[:, 0] = 1.0
    assert response.command(joints, action, response.kinematics(joints)).abs().max() > 0.01
    stretched = joints.clone()
    stretched[:, [1, 3, 5]] = torch.tensor([1.2, -0.4, 1.6])  # the tool is 0.85 m away
    assert torch.equal(response.command(stretched, action, response.kinematics(stretched)), torch.zeros(1, 7))


def test_near_the_edge_of_the_reach_small_steps_find_what_whole_ones_miss(response):
    generator = torch.Generator().manual_seed(0)
    stretched = torch.tensor(ARM.chain.rest) + torch.tensor([0.0, 0.9, 0.0, 1.2, 0.0, -0.3, 0.0])
    joints = stretched + 0.15 * torch.randn(1000, 7, generator=generator)
    action = 2.0 * torch.rand(1000, 7, generator=generator) - 1.0
    kinematics, root = response.kinematics, response.kinematics(joints)
    angles = action[:, 3:6] / action[:, 3:6].norm(dim=-1, keepdim=True).clamp_min(1.0)
    goal = kinematics.target(root, 0.1 * action[:, :3], -0.1 * angles)
    _, whole = kinematics.solve(goal, joints, 3)
    command = response.command(joints, action, root)
    found = command.abs().sum(-1) > 0
    assert found.sum() > 1.3 * (whole < 1e-3).sum()
    _, miss = kinematics.solve(goal, joints + command, 0)
    assert miss[found].max() < 1.1e-3


def test_rest_without_a_command_is_rest(response):
    joints = torch.stack([torch.tensor(ARM.chain.rest), torch.zeros(7)]).expand(2, 2, 7)
    root = response.kinematics(joints[:, 0])
    response.net[-1].bias.fill_(0.3)  # whatever the network says
    step = response(joints, torch.zeros(2, 7), root, 0.0).step
    response.net[-1].bias.zero_()
    assert step.abs().max() < 1e-5


def test_joints_are_solved_for_where_a_scene_does_not_tell_them(response, train_split):
    state = batch_state([train_split.scene(e, k) for e in train_split.episodes for k in (8, 16, 24)])
    known = state.joints[..., :7]
    solved = response.observe(state.frames[:, :, 0])
    for k, angles in enumerate((solved[:, 0], solved[:, 0] - solved[:, 1] / response.braking)):
        roots = response.kinematics(angles)
        torch.testing.assert_close(roots[..., :3, 3], state.frames[:, k, 0, :3, 3], atol=1e-4, rtol=0)
    first = train_split.episodes[0].joints[7:9, 0, :7]
    assert (solved[0, 1] / response.braking - torch.as_tensor(first[1] - first[0])).abs().max() < 0.01
    assert 0.7 < response.braking < 0.95  # the controller brakes
    assert (known - solved)[:, 1].norm() < 0.5 * known[:, 1].norm()


@torch.no_grad()
def test_turning_the_scene_about_the_vertical_turns_the_prediction(response, train_split):
    torch.manual_seed(0)
    model = CompactModel(TASK.layout, TASK.control, SMALL).eval()
    arm = model.robot.arms[0]
    for layer in (model.movers.head, *model.robot.heads, arm.net[-1]):
        torch.nn.init.normal_(layer.weight, std=0.2)
    arm.weight.copy_(response.weight)
    state = model.prepare(batch_state([train_split.scene(e, 8) for e in train_split.episodes[:4]]))
    turn = make_pose(rotation_from_vector(torch.tensor([0.0, 0.0, 0.4])), torch.zeros(3))
    joints = state.joints.clone()
    joints[:, 0, 0] += 0.4
    turned = type(state)(state.layout, state.clouds, turn @ state.frames, joints)
    action = torch.rand(4, 7, generator=torch.Generator().manual_seed(2)) * 0.6 - 0.3
    action[:, 3:5] = 0.0  # the controller turns about x, then y, then z: not quite a vector
    vectors = (action[:, :6].view(4, 2, 3) @ turn[:3, :3].T).flatten(1)
    after = model.step(turned, torch.cat([vectors, action[:, 6:]], 1))
    plain = model.step(state, action)
    torch.testing.assert_close(after.poses(), turn @ plain.poses(), atol=2e-5, rtol=0)
    assert (plain.poses() - state.poses())[:, 0, :3, 3].norm(dim=1).min() > 1e-3
    torch.testing.assert_close(arm.kinematics(plain.joints[:, 0]), plain.poses()[:, 0])


@pytest.mark.parametrize("known", [True, False])
def test_hands_that_hold_each_other_up_make_the_mean_of_their_ways(known):
    """Fully coupled, both hands go where the middle between them goes, and known joints bring them there."""
    task = get_task("TwoArmBoxCleanup")
    torch.manual_seed(0)
    model = CompactModel(task.layout, task.control, replace(SMALL, kinematic=known, uncertain=False)).eval()
    scene = simulated_bank(task, 1).scene(0)
    state = model.prepare(batch_state([scene] * 3))
    for arm in model.robot.arms:
        if known:
            count = arm.joints
            arm.weight[:count, :count] = 0.4 * torch.eye(count)  # nearer to what is asked for
    action = 0.3 * torch.randn(3, task.action_size, generator=torch.Generator().manual_seed(1)).clamp(-1, 1)
    hands, at = list(task.layout.hands), state.poses()[..., :3, 3]
    ways = []
    with torch.no_grad():
        for bias in (-3.0, 10.0):
            model.robot.coupling.bias.fill_(bias)
            after = model.step(state, action)
            ways.append((after.poses()[..., :3, 3] - at)[:, hands])
            if known:
                for k, hand in enumerate(hands):
                    joints = after.joints[:, 0, model.robot.slices[k]]
                    torch.testing.assert_close(model.robot.arms[k].kinematics(joints), after.poses()[:, hand])
    apart, together = ways
    if known:
        assert (apart[:, 0] - apart[:, 1]).norm(dim=-1).min() > 0.003
    torch.testing.assert_close(together[:, 0], together[:, 1], atol=1e-3, rtol=0)
    torch.testing.assert_close(together.mean(1), apart.mean(1), atol=1e-3, rtol=0)
