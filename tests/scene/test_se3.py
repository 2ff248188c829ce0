import numpy as np
import pytest
import roma
import torch
from scipy.spatial.transform import Rotation

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

ANGLES = (0.0, 1e-9, 1e-6, 1e-3, 0.5, 2.0, 3.1)


def vectors(angle, count=20):
    """Rotation vectors (count, 3) of one angle about random axes, float64."""
    axes = np.random.default_rng(0).normal(size=(count, 3))
    return angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)


def random_poses(*shape):
    generator = torch.Generator().manual_seed(0)
    rotation = torch.as_tensor(Rotation.random(int(np.prod(shape)), rng=0).as_matrix()).view(*shape, 3, 3)
    return make_pose(rotation, torch.randn(*shape, 3, generator=generator, dtype=torch.float64))


@pytest.mark.parametrize("angle", (*ANGLES, 4.0, 7.0))
def test_rotation_from_vector_agrees_with_scipy_and_roma(angle):
    v = vectors(angle)
    rotation = rotation_from_vector(torch.as_tensor(v))
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(v).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rotation, roma.rotvec_to_rotmat(torch.as_tensor(v)), atol=1e-12)


def test_rotation_about_an_axis_is_that_of_its_vector():
    axes = torch.as_tensor(vectors(1.0)).unsqueeze(1)  # (n, 1, 3)
    angles = torch.tensor([-2.0, 0.0, 0.3, 3.0], dtype=torch.float64)
    parts = rotation_parts(axes)
    torch.testing.assert_close(rotation_about(parts, angles), rotation_from_vector(angles.unsqueeze(-1) * axes))
    pose = random_poses(1)[0, :3, :3]
    torch.testing.assert_close(rotation_about(pose @ parts, angles), pose @ rotation_about(parts, angles))


def test_constants_first_used_in_inference_mode_serve_gradients():
    vector = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float16)  # of a type that nothing else uses
    with torch.inference_mode():
        rotation_from_vector(vector)
    rotation_from_vector(vector.requires_grad_())[0, 1].backward()
    assert vector.grad is not None


@pytest.mark.parametrize("angle", ANGLES)
def test_vector_from_rotation_inverts_it(angle):
    v = vectors(angle)
    back = vector_from_rotation(rotation_from_vector(torch.as_tensor(v)))
    np.testing.assert_allclose(back, v, atol=1e-9)


@pytest.mark.parametrize("angle", (0.0, 1e-9, 1e-3, 0.1, 1.0))
def test_motion_vector_agrees_with_scipy_well_below_half_a_turn(angle):
    rotation = Rotation.from_rotvec(vectors(angle))
    found = motion_vector(torch.as_tensor(rotation.as_matrix()))
    np.testing.assert_allclose(found, rotation.as_rotvec(), atol=1e-9)


def test_rotation_from_vector_has_the_generators_as_its_gradient_at_rest():
    jacobian = torch.autograd.functional.jacobian(rotation_from_vector, torch.zeros(3, dtype=torch.float64))
    expected = torch.zeros(3, 3, 3, dtype=torch.float64)
    expected[2, 1, 0] = expected[0, 2, 1] = expected[1, 0, 2] = 1.0
    expected -= expected.transpose(0, 1).clone()
    torch.testing.assert_close(jacobian, expected, atol=1e-6, rtol=0)


def test_motion_vector_is_differentiable_at_rest():
    v = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    motion_vector(rotation_from_vector(v))[1].backward()
    torch.testing.assert_close(v.grad, torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64), atol=1e-5, rtol=0)


def test_pose7_and_matrix_agree_with_scipy():
    rotations = Rotation.random(30, rng=1)
    translation = np.random.default_rng(1).normal(size=(30, 3))
    pose7 = np.c_[translation, rotations.as_quat(scalar_first=True)]
    matrix = matrix_from_pose7(torch.as_tensor(pose7))
    np.testing.assert_allclose(matrix[:, :3, :3], rotations.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(matrix[:, :3, 3], translation)
    np.testing.assert_allclose(matrix[:, 3], np.tile([0.0, 0, 0, 1], (30, 1)))


def test_pose7_round_trip_makes_w_positive():
    quaternion = Rotation.random(30, rng=2).as_quat(canonical=True, scalar_first=True)
    pose7 = torch.as_tensor(np.c_[np.ones((30, 3)), quaternion])
    negative = pose7.clone()
    negative[:, 3:] *= -1
    assert (negative[:, 3] < 0).all()
    back = pose7_from_matrix(matrix_from_pose7(negative))
    torch.testing.assert_close(back, pose7, atol=1e-12, rtol=0)


def test_quaternions_that_are_not_quite_unit_give_rotations():
    pose7 = torch.tensor([0.0, 0, 0, 0.99, 0.0, 0.0, 0.2], dtype=torch.float64)
    rotation = matrix_from_pose7(pose7)[:3, :3]
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3, dtype=torch.float64))


def test_inverse_undoes_transform_in_any_batch():
    poses = random_poses(2, 5)
    points = torch.randn(2, 5, 7, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    moved = transform(poses, points)
    expected = poses[1, 4, :3, :3] @ points[1, 4, 6] + poses[1, 4, :3, 3]
    torch.testing.assert_close(moved[1, 4, 6], expected)
    torch.testing.assert_close(transform(inverse(poses), moved), points)
    torch.testing.assert_close(inverse(poses), torch.linalg.inv(poses))


def test_rotation_angle_agrees_with_scipy():
    a, b = Rotation.random(20, rng=4), Rotation.random(20, rng=5)
    found = rotation_angle(torch.as_tensor(a.as_matrix()), torch.as_tensor(b.as_matrix()))
    np.testing.assert_allclose(found, (a.inv() * b).magnitude(), atol=1e-6)
