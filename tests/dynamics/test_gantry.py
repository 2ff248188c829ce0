import pytest
import torch

from pwm_gym.dynamics.compact.gantry import GantryResponse
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Arm, Channel, Control
from pwm_gym.robots.adroit import RELOCATE_HAND

CONTROL = RELOCATE_HAND.control
ARM = CONTROL.arms[0]
COUNT = ARM.gantry.joints


def servo(joints, action):
    """Joints (B, 2, J) a step later of damped springs to targets that the action tells, stiffer off the middle."""
    position, velocity = joints.unbind(1)
    target = 0.3 * action[:, :COUNT]
    velocity = 0.7 * velocity + 0.1 * (target - position) - 0.2 * position**3
    return torch.stack([position + velocity, velocity], 1)


def transitions(count, seed):
    generator = torch.Generator().manual_seed(seed)
    joints = torch.randn(count, 2, COUNT, generator=generator) * torch.tensor([0.3, 0.01]).view(1, 2, 1)
    action = torch.rand(count, CONTROL.size, generator=generator).mul(2).sub(1)
    return joints, action, servo(joints, action)


@pytest.fixture(scope="module")
def response():
    torch.manual_seed(0)
    fitted = GantryResponse(ARM, CONTROL, width=64)
    fitted.fit(*transitions(4000, 0), steps=600, floor=0.0)
    return fitted.requires_grad_(False)


def predicted(response, joints, action):
    forecast = response(joints, action, response.kinematics(joints[:, 0]), 0.0)
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
    hand = response.kinematics(torch.stack([following[:, 0], joints[:, 0], joints[:, 0]], 1))
    seen = response.observe(hand)
    torch.testing.assert_close(seen[:, 0], following[:, 0], atol=1e-5, rtol=0)
    torch.testing.assert_close(seen[:, 1], response.braking * (following[:, 0] - joints[:, 0]), atol=2e-5, rtol=0)


def test_joints_at_their_limits_come_to_rest(response):
    asked = torch.tensor([[9.0] * 3 + [0.0] * (COUNT - 3)])
    reached = response.kinematics.limit(asked)
    velocity = response.stop(torch.full((1, COUNT), 0.02), asked, reached)
    torch.testing.assert_close(velocity, torch.tensor([[0.0] * 3 + [0.02] * (COUNT - 3)]))


@pytest.mark.parametrize("channels", [(), (Channel("joint", 0, COUNT - 1, rest=None, arm="arm"),)])
def test_a_channel_has_a_target_for_each_joint(channels):
    with pytest.raises(PwmGymError, match="no channel has a target for each of its joints"):
        GantryResponse(ARM, Control(channels, (ARM,)))


def test_an_arm_without_a_gantry_has_no_such_response():
    with pytest.raises(PwmGymError, match="arm 'arm' is no known gantry"):
        GantryResponse(Arm("arm", "forearm"), CONTROL)
