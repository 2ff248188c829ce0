import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pwm_gym.scene import EntityPoints, Layout, PointState, RigidState, State, pose_features, stack
from pwm_gym.scene.se3 import make_pose, rotation_from_vector

LAYOUT = Layout.build([("hand", 40), ("finger", 24), ("cube", 30)], driven=("hand", "finger"))


@pytest.fixture
def state() -> RigidState:
    """Two scenes whose three entities have moved at random, centimetres and tenths of radians a step."""
    generator = torch.Generator().manual_seed(0)
    clouds = 0.05 * torch.randn(2, LAYOUT.points, 3, generator=generator)
    vector, place = torch.randn(2, 2, 1, 3, 3, generator=generator).mul(0.5)
    turns, moves = torch.randn(2, 2, 3, 3, 3, generator=generator).mul(0.05)
    frames = make_pose(rotation_from_vector(vector + turns), place + moves)
    return RigidState(LAYOUT, clouds, frames)


def spinning(omega, axis, centre, steps=3):
    """Poses (steps, 4, 4), newest first, of a body that turns ``omega`` radians a step about an axis."""
    poses = []
    for k in range(steps):
        rotation = torch.as_tensor(Rotation.from_rotvec(-k * omega * axis).as_matrix())
        poses.append(make_pose(rotation, centre - rotation @ centre))
    return torch.stack(poses)


def test_a_cloud_that_turns_about_an_axis_has_the_velocity_of_its_circles():
    axis = np.array([0.0, 0.6, 0.8])
    centre, omega = torch.tensor([0.5, -0.2, 0.1], dtype=torch.float64), 0.1
    cloud = torch.randn(50, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    frames = spinning(omega, axis, centre)
    state = RigidState(Layout.build([("disc", 50)]), cloud, frames[:, None])

    arm = state.points() - centre
    arm = arm - (arm @ torch.as_tensor(axis))[:, None] * torch.as_tensor(axis)
    chord = 2 * np.sin(omega / 2) * arm.norm(dim=-1)
    velocity = state.velocity()
    torch.testing.assert_close(velocity.norm(dim=-1), chord)
    torch.testing.assert_close(
        velocity @ torch.as_tensor(axis), torch.zeros(50, dtype=torch.float64), atol=1e-12, rtol=0
    )
    # The chord's direction is that of omega x r half a step ago.
    half = torch.as_tensor(Rotation.from_rotvec(-0.5 * omega * axis).as_matrix())
    tangent = torch.linalg.cross(torch.as_tensor(axis).expand(50, 3), arm @ half.T)
    torch.testing.assert_close(velocity / chord[:, None], tangent / arm.norm(dim=-1, keepdim=True))
    torch.testing.assert_close(state.previous_velocity().norm(dim=-1), chord)


def test_points_are_canonical_clouds_carried_by_the_poses(state):
    pose = state.frames[1, 2, 0].numpy()
    expected = state.clouds[1, :40].numpy() @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(state.entity("hand", 2)[1], expected, atol=1e-6)
    np.testing.assert_array_equal(state.points()[:, 40:64], state.entity("finger"))
    np.testing.assert_allclose(state.velocity()[:, 64:], state.entity("cube") - state.entity("cube", 1))


@pytest.mark.parametrize("of", ["points", "velocity", "previous_velocity", "poses", "history"])
def test_a_state_of_points_agrees_with_the_rigid_one(state, of):
    points = PointState.of(state)
    assert isinstance(points, State) and isinstance(state, State)
    torch.testing.assert_close(getattr(points, of)(), getattr(state, of)(), atol=1e-4, rtol=0)
    assert points.batch == state.batch == (2,)


def test_registration_finds_rotations_not_reflections(state):
    poses = PointState.of(state).poses()
    torch.testing.assert_close(torch.linalg.det(poses[..., :3, :3]), torch.ones(2, 3), atol=1e-5, rtol=0)


@pytest.mark.parametrize("form", [lambda s: s, PointState.of], ids=["rigid", "points"])
def test_advance_makes_the_present_the_past(state, form):
    now = form(state)
    target = now.frames[..., 0, :, :] if isinstance(now, PointState) else now.poses()
    after = now.advance(target.clone())
    torch.testing.assert_close(after.points(), now.points())
    torch.testing.assert_close(after.velocity(), torch.zeros_like(now.velocity()))
    torch.testing.assert_close(after.previous_velocity(), now.velocity())
    assert after.frames.shape == now.frames.shape


@pytest.mark.parametrize("form", [lambda s: s, PointState.of], ids=["rigid", "points"])
def test_stack_and_index_are_inverse(state, form):
    first = form(state)
    second = first.map(lambda x: x + 0.01)
    both = stack([first, first.advance(second.poses() if isinstance(first, RigidState) else second.points())], 1)
    assert both.batch == (2, 2)
    assert both.points().shape == (2, 2, LAYOUT.points, 3)
    torch.testing.assert_close(both[:, 0].points(), first.points())
    torch.testing.assert_close(both[:, 1].previous_velocity(), first.velocity())
    torch.testing.assert_close(both.poses()[1, 0], first.poses()[1])


def test_coarsen_keeps_each_entitys_first_points(state):
    coarse = state.coarsen(LAYOUT.truncate(10))
    assert coarse.points().shape == (2, 30, 3)
    for name in LAYOUT.names:
        torch.testing.assert_close(coarse.entity(name), state.entity(name)[:, :10])


def test_entity_points_form_a_mapping_of_positions_or_velocities(state):
    points, velocity = EntityPoints(state), EntityPoints(state, velocity=True)
    assert list(points) == ["hand", "finger", "cube"] and len(points) == 3
    assert points["cube"] is points["cube"]
    torch.testing.assert_close(torch.cat(list(velocity.values()), 1), state.velocity())
    with pytest.raises(KeyError, match="no entity 'lid'; this scene has hand, finger, cube"):
        points["lid"]


def test_what_stands_still_in_some_scenes_has_a_velocity_in_the_others(state):
    frames = state.frames.clone()
    frames[0, 1, 2] = frames[0, 0, 2]  # the cube of the first scene has just come to rest
    frames[:, :, 1] = frames[:, :1, 1]  # the finger rests in both
    resting = RigidState(LAYOUT, state.clouds, frames)
    points, velocity, previous = resting.motion()
    torch.testing.assert_close(points, resting.points())
    torch.testing.assert_close(velocity, resting.velocity(), atol=1e-6, rtol=0)
    torch.testing.assert_close(previous, resting.previous_velocity(), atol=1e-6, rtol=0)
    assert (velocity[:, 40:64] == 0).all() and (velocity[0, 64:] == 0).all() and (velocity[1, 64:] != 0).any()
    one = resting[1].motion()
    for all_scenes, alone in zip((points, velocity, previous), one, strict=True):
        torch.testing.assert_close(all_scenes[1], alone, atol=1e-6, rtol=0)


def test_pose_features_hold_place_orientation_and_motion(state):
    goal = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    features = pose_features(state, goal)
    assert features.shape == (2, 12 * 3 + 3)
    first = features[1, 12:24]
    torch.testing.assert_close(first[:3], state.poses()[1, 1, :3, 3])
    torch.testing.assert_close(first[3:9].view(3, 2), state.poses()[1, 1, :3, :2])
    torch.testing.assert_close(first[9:], (state.frames[1, 0] - state.frames[1, 1])[1, :3, 3])
    torch.testing.assert_close(features[:, -3:], goal)
