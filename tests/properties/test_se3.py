"""Rigid motions: what holds of all of them."""

import math

import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pwm_gym.scene.poses import mirrored
from pwm_gym.scene.se3 import (
    inverse,
    make_pose,
    matrix_from_pose7,
    motion_vector,
    pose7_from_matrix,
    rotation_about,
    rotation_angle,
    rotation_from_vector,
    rotation_parts,
    transform,
    vector_from_rotation,
)

metres = st.floats(-3, 3)
places = st.tuples(metres, metres, metres)
AXES = [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0.6, 0, -0.8), (2 / 3, 2 / 3, 1 / 3)]


@st.composite
def vectors(draw, largest=math.pi):
    """Rotation vectors: of every direction and angle, the smallest ones and half turns included."""
    axis = torch.tensor(draw(st.sampled_from(AXES) | places), dtype=torch.float64)
    length = axis.norm()
    unit = axis / length if length > 1e-3 else torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    special = st.sampled_from([0.0, 1e-12, 1e-7, 1e-4, largest - 1e-6, largest])
    return unit * draw(special | st.floats(0, largest))


@st.composite
def poses(draw):
    return make_pose(rotation_from_vector(draw(vectors())), torch.tensor(draw(places), dtype=torch.float64))


clouds = st.lists(places, min_size=1, max_size=5).map(lambda points: torch.tensor(points, dtype=torch.float64))


def close(found, expected, atol=1e-9):
    torch.testing.assert_close(found, expected, atol=atol, rtol=0)


@given(poses())
def test_a_pose_and_its_inverse_are_the_identity(pose):
    close(pose @ inverse(pose), torch.eye(4, dtype=torch.float64))
    close(inverse(inverse(pose)), pose)


@given(poses(), poses(), clouds)
def test_moving_twice_is_moving_by_the_product(first, second, points):
    close(transform(second, transform(first, points)), transform(second @ first, points))
    close(inverse(second @ first), inverse(first) @ inverse(second))


@given(poses(), clouds)
def test_a_motion_keeps_distances(pose, points):
    close(torch.cdist(transform(pose, points), transform(pose, points)), torch.cdist(points, points), 1e-7)


@given(vectors())
def test_a_rotation_is_scipys(vector):
    rotation = rotation_from_vector(vector)
    close(rotation, torch.as_tensor(Rotation.from_rotvec(vector.numpy()).as_matrix()))
    close(rotation @ rotation.T, torch.eye(3, dtype=torch.float64))
    assert abs(float(torch.linalg.det(rotation)) - 1.0) < 1e-9


@given(vectors())
def test_a_rotations_vector_makes_the_rotation_again(vector):
    rotation = rotation_from_vector(vector)
    found = vector_from_rotation(rotation)
    assert float(found.norm()) <= math.pi + 1e-6
    close(rotation_from_vector(found), rotation, 1e-6)


@given(vectors(largest=2.0))
def test_the_vector_of_a_small_motion_is_the_exact_one(vector):
    close(motion_vector(rotation_from_vector(vector)), vector, 2e-6)


@given(vectors(), vectors(largest=2.0))
def test_a_vector_turns_with_its_axes(turn, vector):
    turn = rotation_from_vector(turn)
    close(rotation_from_vector(turn @ vector), turn @ rotation_from_vector(vector) @ turn.T)
    close(motion_vector(turn @ rotation_from_vector(vector) @ turn.T), turn @ vector, 2e-6)


@given(vectors(), vectors(), vectors())
def test_the_angle_between_rotations_does_not_depend_on_where_they_are_seen_from(one, other, turn):
    one, other, turn = map(rotation_from_vector, (one, other, turn))
    angle = rotation_angle(one, other)
    close(rotation_angle(turn @ one, turn @ other), angle, 1e-6)
    close(rotation_angle(other, one), angle, 1e-6)
    assert 0.0 <= float(angle) <= math.pi + 1e-9


@given(st.sampled_from(AXES), st.floats(-7, 7))
def test_a_turn_about_an_axis_is_that_of_its_vector(axis, angle):
    axis = torch.tensor(axis, dtype=torch.float64)
    turned = rotation_about(rotation_parts(axis), torch.tensor(angle, dtype=torch.float64))
    close(turned, rotation_from_vector(angle * axis))
    close(turned @ axis, axis)


@given(poses())
def test_a_pose_survives_its_short_form(pose):
    short = pose7_from_matrix(pose)
    assert float(short[3]) >= 0.0 and abs(float(short[3:].norm()) - 1.0) < 1e-9
    close(matrix_from_pose7(short), pose, 1e-7)
    close(matrix_from_pose7(torch.cat([short[:3], -2.5 * short[3:]])), pose, 1e-7)  # of either sign and any length


@given(st.lists(poses(), min_size=1, max_size=4), clouds)
def test_a_batch_is_its_elements(every, points):
    together = torch.stack(every)
    close(inverse(together), torch.stack([inverse(p) for p in every]), 1e-12)
    close(transform(together, points), torch.stack([transform(p, points) for p in every]), 1e-12)
    close(pose7_from_matrix(together), torch.stack([pose7_from_matrix(p) for p in every]), 1e-12)


@given(poses())
def test_a_mirrored_pose_shows_its_mirrored_points_in_the_mirror(pose):
    mirror = torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0], dtype=torch.float64))
    pose7 = pose7_from_matrix(pose).numpy()
    close(matrix_from_pose7(torch.as_tensor(mirrored(pose7))), mirror @ pose @ mirror, atol=1e-6)
    close(torch.as_tensor(mirrored(mirrored(pose7))), torch.as_tensor(pose7))
