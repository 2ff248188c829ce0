import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pwm_gym.dynamics.response import EndEffector, LinearResponse, twists
from pwm_gym.scene.se3 import make_pose, rotation_from_vector

ACTION = 7


def arx_weights(seed=0):
    """A stable response of two past twists (12) and an action (7) to the next twist (6)."""
    rng = torch.Generator().manual_seed(seed)
    weight = 0.05 * torch.randn(12 + ACTION, 6, generator=rng)
    weight[:6] += 0.5 * torch.eye(6)
    weight[12:] *= 0.1  # centimetres and hundredths of radians a unit
    return weight


def simulate(layout, weight, slide, steps=400, seed=1):
    """Frames (T, 3, E, 4, 4), actions (T, A) and next poses (T, E, 4, 4) of a hand that responds by ``weight``."""
    rng = torch.Generator().manual_seed(seed)
    effector = EndEffector(layout)
    pose, twist = torch.eye(4, dtype=torch.float64), torch.zeros(2, 6, dtype=torch.float64)
    opening = torch.full((3, 2), 0.02, dtype=torch.float64)
    actions = torch.rand(steps, ACTION, generator=rng, dtype=torch.float64) * 2 - 1
    poses, openings = [pose] * 3, [opening[0]] * 3
    for action in actions:
        twist = torch.stack([torch.cat([twist.flatten(), action]) @ weight.double(), twist[0]])
        turned = rotation_from_vector(twist[0, 3:]) @ pose[:3, :3]
        pose = make_pose(turned, pose[:3, 3] + twist[0, :3])
        speeds = opening[:2] - opening[1:]
        features = torch.cat([opening[0], speeds.flatten(), action, torch.ones(1, dtype=torch.float64)])
        opening = torch.cat([(opening[0] + features @ slide.double())[None], opening[:2]])
        poses.append(pose)
        openings.append(opening[0])
    root, widths = torch.stack(poses).float(), torch.stack(openings).float()
    cube = torch.eye(4).expand(len(root), 1, 4, 4)
    every = torch.cat([root[:, None], effector.links(root, widths), cube], 1)
    frames = torch.stack([every[2:-1], every[1:-2], every[:-3]], 1)
    return frames, actions.float(), every[3:]


def slide_weights():
    weight = torch.zeros(6 + ACTION + 1, 2)
    weight[0, 0] = weight[1, 1] = -0.2  # drawn to ...
    weight[-1] = 0.2 * 0.02  # ... an opening of 2 cm
    weight[2, 0] = weight[3, 1] = 0.3
    weight[6 + 6] = 0.002  # the gripper's command
    return weight


@pytest.fixture
def layout(hand_scenes):
    return hand_scenes(1).layout


def test_fit_recovers_the_coefficients_of_a_linear_system(layout):
    weight, slide = arx_weights(), slide_weights()
    response = LinearResponse(layout, ACTION)
    response.fit(*simulate(layout, weight, slide))
    torch.testing.assert_close(response.root_weight, weight, atol=2e-3, rtol=0)
    # Both fingers move alike, so that only the sum of their coefficients is told by the data.
    frames, actions, following = simulate(layout, weight, slide, seed=2)
    openings = response.effector.openings(frames)
    predicted = openings[:, 0] + response(frames, openings, actions)[1]
    actual = response.effector.openings(following.unsqueeze(1).expand(-1, 3, -1, -1, -1))[:, 0]
    torch.testing.assert_close(predicted, actual, atol=2e-6, rtol=0)
    torch.testing.assert_close(response.slide_weight[12], slide[12], atol=1e-4, rtol=0)


def test_at_rest_without_a_command_it_rests(layout, hand_scenes):
    response = LinearResponse(layout, ACTION)
    response.root_weight.normal_(generator=torch.Generator().manual_seed(0))
    state = hand_scenes(3, moving=False)
    root, _ = response(state.frames, response.effector.openings(state.frames), torch.zeros(3, ACTION))
    assert torch.equal(root, torch.zeros(3, 6))


def test_twists_are_scipys(hand_scenes):
    frames = hand_scenes(5).frames[:, :, 0]
    found = twists(frames)
    for k in range(2):
        turn = Rotation.from_matrix(frames[:, k, :3, :3]) * Rotation.from_matrix(frames[:, k + 1, :3, :3]).inv()
        np.testing.assert_allclose(found[:, k, 3:], turn.as_rotvec(), atol=1e-6)
        np.testing.assert_allclose(found[:, k, :3], frames[:, k, :3, 3] - frames[:, k + 1, :3, 3])


def test_openings_and_links_are_inverse(hand_scenes):
    state = hand_scenes(6)
    effector = EndEffector(state.layout)
    openings = effector.openings(state.frames)
    links = effector.links(state.frames[:, :, effector.root], openings)
    torch.testing.assert_close(links, state.frames[:, :, effector.sliding], atol=1e-6, rtol=0)


def test_openings_stay_within_the_joints_limits(layout):
    limited = EndEffector(layout).limit(torch.tensor([[-0.01, 0.05], [0.01, 0.04]]))
    torch.testing.assert_close(limited, torch.tensor([[0.0, 0.04], [0.01, 0.04]]))


def test_positions_are_confined_to_what_was_observed(layout):
    response = LinearResponse(layout, ACTION)
    frames, actions, following = simulate(layout, arx_weights(), slide_weights())
    anywhere = torch.tensor([[3.0, 4.0, 5.0], [0.0, 0.0, -7.0]])
    torch.testing.assert_close(response.confine(anywhere), anywhere)  # until it is fitted
    response.fit(frames, actions, following)
    seen = following[:, 0, :3, 3]
    torch.testing.assert_close(response.confine(seen), seen)
    far = response.confine(anywhere)
    torch.testing.assert_close(far[0, :2].norm(), seen[:, :2].norm(dim=-1).max())
    torch.testing.assert_close(far[0, 1] / far[0, 0], torch.tensor(4 / 3))
    torch.testing.assert_close(far[:, 2], torch.stack([seen[:, 2].max(), seen[:, 2].min()]))


def test_an_unfitted_reach_has_a_gradient(layout):
    position = torch.tensor([[0.5, 0.1, 0.2]], requires_grad=True)
    LinearResponse(layout, ACTION).confine(position).sum().backward()
    torch.testing.assert_close(position.grad, torch.ones(1, 3))
