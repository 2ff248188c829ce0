from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pwm_gym.dynamics.response import LinearResponse, twists
from pwm_gym.scene.se3 import make_pose, rotation_from_vector

ACTION = 7


def arx_weights(seed=0, hands=1):
    """Stable responses of two past twists (12) and an action (7) to the next twist (6)."""
    rng = torch.Generator().manual_seed(seed)
    weight = 0.05 * torch.randn(hands, 12 + ACTION, 6, generator=rng)
    weight[:, :6] += 0.5 * torch.eye(6)
    weight[:, 12:] *= 0.1  # centimetres and hundredths of radians a unit
    return weight


def finger_weights(joints, gripper=6):
    """Joints that are drawn to 2 cm (radians), and follow the gripper's command."""
    weight = torch.zeros(3 * joints + ACTION + 1, joints)
    weight[:joints] = -0.2 * torch.eye(joints)
    weight[joints : 2 * joints] = 0.3 * torch.eye(joints)
    weight[3 * joints + gripper] = 0.002
    weight[-1] = 0.2 * 0.02
    return weight


def simulate(links, hand_weight, joint_weight, steps=400, seed=1):
    """Frames (T, 3, L, 4, 4), actions (T, A) and next poses (T, L, 4, 4) of a robot that responds by its weights."""
    response = LinearResponse(links, ACTION).double()
    response.hand_weight.copy_(hand_weight)
    response.joint_weight.copy_(joint_weight)
    rng = torch.Generator().manual_seed(seed)
    actions = torch.rand(steps, ACTION, generator=rng, dtype=torch.float64) * 2 - 1
    joints = len(response.tree)
    first = torch.eye(4, dtype=torch.float64).repeat(len(links), 1, 1)
    first = response.tree.place(first, torch.full((joints,), 0.02, dtype=torch.float64))
    poses = [first] * 3
    for action in actions:
        frames = torch.stack(poses[-1:-4:-1]).unsqueeze(0)  # newest first
        twist = response.hand_twists(frames, action[None])[0]
        step = response.joint_step(response.tree.positions(frames), action[None])[0]
        after = poses[-1].clone()
        for k, hand in enumerate(response.hands):
            turned = rotation_from_vector(twist[k, 3:]) @ after[hand, :3, :3]
            after[hand] = make_pose(turned, after[hand, :3, 3] + twist[k, :3])
        poses.append(response.tree.place(after, response.tree.positions(poses[-1]) + step, poses[-1]))
    every = torch.stack(poses).float()
    return torch.stack([every[2:-1], every[1:-2], every[:-3]], 1), actions.float(), every[3:]


@pytest.fixture
def links(worlds):
    return worlds["cube"].layout.robot()


def test_fit_recovers_the_coefficients_of_a_linear_system(links):
    weight, fingers = arx_weights(), finger_weights(2)
    response = LinearResponse(links, ACTION)
    response.fit(*simulate(links, weight, fingers))
    torch.testing.assert_close(response.hand_weight, weight, atol=3e-3, rtol=0)
    # Both fingers move alike, so that only the sum of their coefficients is told by the data.
    frames, actions, following = simulate(links, weight, fingers, seed=2)
    positions = response.tree.positions(frames)
    predicted = positions[:, 0] + response.joint_step(positions, actions)
    torch.testing.assert_close(predicted, response.tree.positions(following), atol=3e-6, rtol=0)
    torch.testing.assert_close(response.joint_weight[12], fingers[12], atol=1e-4, rtol=0)


def test_every_hand_and_every_joint_of_a_chain_has_its_own_response(worlds):
    links = worlds["two arms"].layout.robot()
    weight, fingers = arx_weights(hands=2), finger_weights(6)
    fingers[18:24] = 0.01 * torch.randn(6, 6, generator=torch.Generator().manual_seed(3))
    response = LinearResponse(links, ACTION)
    response.fit(*simulate(links, weight, fingers))
    torch.testing.assert_close(response.hand_weight, weight, atol=3e-3, rtol=0)
    frames, actions, following = simulate(links, weight, fingers, seed=2)
    positions = response.tree.positions(frames)
    predicted = positions[:, 0] + response.joint_step(positions, actions)
    torch.testing.assert_close(predicted, response.tree.positions(following), atol=1e-5, rtol=0)


def test_a_robot_without_hands_or_joints_is_fitted_too(worlds):
    bolted = worlds["bolted hand"].layout.robot()
    response = LinearResponse(bolted, ACTION)
    response.fit(*simulate(bolted, torch.zeros(0, 19, 6), finger_weights(1)))
    assert response.joint_weight.abs().sum() > 0 and response.hand_weight.shape == (0, 19, 6)
    hand = worlds["unknown arm"].layout.robot()
    alone = LinearResponse(hand, ACTION)
    alone.fit(*simulate(hand, arx_weights(), torch.zeros(8, 0)))
    torch.testing.assert_close(alone.hand_weight, arx_weights(), atol=3e-3, rtol=0)


def test_at_rest_without_a_command_it_rests(links, hand_scenes):
    response = LinearResponse(links, ACTION)
    response.hand_weight.normal_(generator=torch.Generator().manual_seed(0))
    frames = hand_scenes(3, moving=False).frames[:, :, :3]
    assert torch.equal(response.hand_twists(frames, torch.zeros(3, ACTION)), torch.zeros(3, 1, 6))


def test_twists_are_scipys(hand_scenes):
    frames = hand_scenes(5).frames[:, :, 0]
    found = twists(frames)
    for k in range(2):
        turn = Rotation.from_matrix(frames[:, k, :3, :3]) * Rotation.from_matrix(frames[:, k + 1, :3, :3]).inv()
        np.testing.assert_allclose(found[:, k, 3:], turn.as_rotvec(), atol=1e-6)
        np.testing.assert_allclose(found[:, k, :3], frames[:, k, :3, 3] - frames[:, k + 1, :3, 3])


def test_positions_are_confined_to_what_was_observed(links):
    response = LinearResponse(links, ACTION)
    frames, actions, following = simulate(links, arx_weights(), finger_weights(2))
    anywhere = torch.tensor([[[3.0, 4.0, 5.0]], [[0.0, 0.0, -7.0]]])  # (2, H, 3)
    torch.testing.assert_close(response.confine(anywhere), anywhere)  # until it is fitted
    response.fit(frames, actions, following)
    seen = following[:, :1, :3, 3]
    torch.testing.assert_close(response.confine(seen), seen)
    far = response.confine(anywhere)
    torch.testing.assert_close(far[0, 0, :2].norm(), seen[..., :2].norm(dim=-1).max())
    torch.testing.assert_close(far[0, 0, 1] / far[0, 0, 0], torch.tensor(4 / 3))
    torch.testing.assert_close(far[:, 0, 2], torch.stack([seen[..., 2].max(), seen[..., 2].min()]))


def test_an_unfitted_reach_has_a_gradient(links):
    position = torch.tensor([[[0.5, 0.1, 0.2]]], requires_grad=True)
    LinearResponse(links, ACTION).confine(position).sum().backward()
    torch.testing.assert_close(position.grad, torch.ones(1, 1, 3))


def test_links_of_any_order_have_the_same_response(worlds):
    """Fingers may be listed before their hand."""
    links = worlds["cube"].layout.robot()
    other = replace(links, entities=()).plus([links.entities[k] for k in (1, 0, 2)])
    frames, actions, following = simulate(links, arx_weights(), finger_weights(2))
    a, b = LinearResponse(links, ACTION), LinearResponse(other, ACTION)
    a.fit(frames, actions, following)
    b.fit(frames[:, :, [1, 0, 2]], actions, following[:, [1, 0, 2]])
    torch.testing.assert_close(a.hand_weight, b.hand_weight)


def test_a_hand_that_is_told_where_to_be_goes_there(worlds):
    """Each component draws the hand to a place along one axis, or to an angle about it."""
    hand = worlds["unknown arm"].layout.robot()
    rng = torch.Generator().manual_seed(0)
    actions = torch.rand(400, 6, generator=rng, dtype=torch.float64) * 2 - 1
    targets = actions * torch.tensor([0.2, 0.2, 0.2, 0.1, 0.1, 0.1])
    places = [torch.zeros(6, dtype=torch.float64)] * 3
    for target in targets:
        speed = places[-1] - places[-2]
        places.append(places[-1] + 0.4 * speed + 0.2 * (target - places[-1]))
    every = torch.stack(places)
    poses = make_pose(rotation_from_vector(every[:, 3:]), every[:, :3]).float().unsqueeze(1)
    frames = torch.stack([poses[2:-1], poses[1:-2], poses[:-3]], 1)
    misses = {}
    for told in (False, True):
        response = LinearResponse(hand, 6, targets=told)
        response.fit(frames, actions.float(), poses[3:])
        found = response.hand_twists(frames, actions.float())[:, 0]
        misses[told] = float(
            (found - twists(torch.stack([poses[3:], poses[2:-1], poses[1:-2]], 1)[:, :, 0])[:, 0]).norm()
        )
    assert misses[True] < 0.05 * misses[False]
