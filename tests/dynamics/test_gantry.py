from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.dynamics import CompactModel
from pwm_gym.dynamics.compact.gantry import GantryResponse
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Arm, Channel, Control
from pwm_gym.robots.adroit import RELOCATE_HAND
from pwm_gym.scene import Scene, batch_state, sample_clouds
from pwm_gym.tasks import get_task

ARM = replace(RELOCATE_HAND.control.arms[0], links=("wrist", "palm"))
COUNT = ARM.gantry.joints
ALL = COUNT + 2
CONTROL = Control((Channel("joint", 0, COUNT, rest=None, arm="arm"), Channel("finger", COUNT, ALL, rest=None)), (ARM,))
LIMITS = torch.tensor([[-0.5], [0.5]]).repeat(1, len(ARM.links))


def servo(joints, action):
    """Joints (B, 2, J) a step later of damped springs to targets that the action tells, stiffer off the middle."""
    position, velocity = joints.unbind(1)
    target = 0.3 * action[:, : joints.shape[2]]
    velocity = 0.7 * velocity + 0.1 * (target - position) - 0.2 * position**3
    return torch.stack([position + velocity, velocity], 1)


def transitions(count, seed, size=ALL):
    generator = torch.Generator().manual_seed(seed)
    joints = torch.randn(count, 2, size, generator=generator) * torch.tensor([0.3, 0.01]).view(1, 2, 1)
    action = torch.rand(count, CONTROL.size, generator=generator).mul(2).sub(1)
    return joints, action, servo(joints, action)


@pytest.fixture(scope="module")
def response():
    torch.manual_seed(0)
    fitted = GantryResponse(ARM, CONTROL, width=64, limits=LIMITS)
    fitted.fit(*transitions(4000, 0), steps=600, floor=0.0)
    return fitted.requires_grad_(False)


def predicted(response, joints, action):
    forecast = response(joints, action, response.hand(joints[:, 0]), 0.0)
    assert forecast.features.shape == (len(joints), response.features)
    step = forecast.step
    return torch.stack([joints[:, 0] + step[:, 0], step[:, 1]], 1)


def test_the_fitted_joints_follow_their_targets(response):
    joints, action, following = transitions(500, 1)
    error = (predicted(response, joints, action) - following).norm(dim=-1).mean(0)
    moved = (following - joints).norm(dim=-1).mean(0)
    assert (error < 0.2 * moved).all(), (error, moved)


def test_errors_do_not_add_up(response):
    """Two hundred steps to fixed targets end where the servo ends."""
    joints, action, _ = transitions(50, 2)
    truth = found = joints
    for _ in range(200):
        truth, found = servo(truth, action), predicted(response, found, action)
    assert (truth[:, 1].abs() < 1e-3).all()
    assert (truth[:, 0] - found[:, 0]).abs().mean() < 0.02


def test_joints_are_observed_behind_a_hand(response):
    joints, _, following = transitions(40, 3)
    positions = torch.stack([following[:, 0], joints[:, 0], joints[:, 0]], 1)
    seen = response.observe(response.hand(positions), positions[..., COUNT:])
    torch.testing.assert_close(seen[:, 0], following[:, 0], atol=1e-5, rtol=0)
    moved = following[:, 0] - joints[:, 0]
    torch.testing.assert_close(seen[:, 1, :COUNT], response.braking * moved[:, :COUNT], atol=2e-5, rtol=0)
    torch.testing.assert_close(seen[:, 1, COUNT:], response.links.braking * moved[:, COUNT:], atol=2e-5, rtol=0)


def test_a_gantry_without_links_has_its_own_targets_alone():
    """Its hand's joints are then no part of the response."""
    arm = replace(ARM, links=())
    alone = GantryResponse(arm, CONTROL, width=64)
    alone.fit(*transitions(4000, 0, COUNT), steps=100, floor=0.0)
    joints, action, following = transitions(500, 1, COUNT)
    others = torch.cat([action[:, :COUNT], -action[:, COUNT:]], 1)
    found = predicted(alone, joints, action)
    torch.testing.assert_close(found, predicted(alone, joints, others))
    assert (found - following).norm() < 0.3 * (joints - following).norm()


def test_links_go_past_their_limits_like_springs(response):
    far = torch.full((1, ALL), 9.0)
    torch.testing.assert_close(response.limit(far)[:, COUNT:], torch.ones(1, 2))
    torch.testing.assert_close(response.limit(-far)[:, COUNT:], -torch.ones(1, 2))


def test_links_are_hardly_faster_than_ever_observed(response):
    """Whatever a rollout came to, its velocities stay finite."""
    _, _, following = transitions(4000, 0)
    found = response.slow(torch.full((1, 2, ALL), 1e6))
    assert (found[..., :COUNT] == 1e6).all()
    assert (found[..., COUNT:] < 2.0).all()
    assert (found[0, 1, COUNT:] >= following[:, 1, COUNT:].amax(0)).all()


def test_a_hands_links_stand_at_its_joints():
    """What the model carries as joints and what it shows are one, past the links' limits, too."""
    task = get_task("AdroitHandDoor")
    own = task.robot.control.arms[0].gantry.joints
    simulator = task.make_simulator()
    simulator.reset(0)
    model = CompactModel(task.layout, task.robot.control).requires_grad_(False)
    scene = Scene(
        task.name,
        task.layout,
        sample_clouds(simulator.meshes(), task.layout, 0),
        np.stack([simulator.poses()] * 3),
        simulator.goal(),
        simulator.joints(),
    )
    simulator.close()
    state = model.prepare(batch_state([scene]))
    assert state.joints.shape == (1, 2, task.action_size)
    model.robot.arms[0].links.weight[-1] = 0.05  # every joint goes on, whatever it is told
    for _ in range(40):
        state = model.step(state, torch.zeros(1, task.action_size))
    tree = model.robot.response.tree
    positions = tree.positions(state.frames[:, 0, : len(model.links)])
    torch.testing.assert_close(positions, state.joints[:, 0, own:], atol=1e-4, rtol=0)
    assert (positions > tree.upper).any()


@pytest.mark.parametrize(
    "channels",
    [
        (),
        (Channel("joint", 0, ALL - 1, rest=None, arm="arm"),),
        (Channel("joint", 0, COUNT, rest=None, arm="arm"),),
    ],
)
def test_a_channel_has_a_target_for_each_joint(channels):
    with pytest.raises(PwmGymError, match="no channel has a target for each of its joints"):
        GantryResponse(ARM, Control(channels, (ARM,)))


def test_an_arm_without_a_gantry_has_no_such_response():
    with pytest.raises(PwmGymError, match="arm 'arm' is no known gantry"):
        GantryResponse(Arm("arm", "forearm"), CONTROL)
