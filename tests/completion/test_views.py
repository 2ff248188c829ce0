from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from pwm_gym.completion import LEAST, ViewConfig, ViewerFrame, Views
from pwm_gym.errors import PwmGymError

MESHES = [
    trimesh.creation.box((1.0, 0.5, 0.3)),
    trimesh.creation.icosphere(3, 0.5),
    trimesh.creation.cylinder(0.05, 1.0),
]
CLEAN = ViewConfig().clean()


def posed(points, view):
    return points @ view.pose[:3, :3].T + view.pose[:3, 3]


@pytest.mark.parametrize("index", range(3))
def test_a_clean_view_lies_on_the_side_of_the_surface_that_faces_the_camera(index):
    views = Views(MESHES, CLEAN)
    for seed in range(5):
        view = views.view(index, np.random.default_rng(seed))
        assert len(view.partial) >= LEAST and view.partial.dtype == np.float32
        surface, faces = trimesh.sample.sample_surface(MESHES[index], 20_000, seed=0)
        gap, nearest = cKDTree(posed(surface, view)).query(view.partial)
        assert np.quantile(gap, 0.95) < 0.02
        normals = MESHES[index].face_normals[faces[nearest]] @ view.pose[:3, :3].T
        assert ((normals * view.partial).sum(1) < 0).mean() > 0.95


def test_the_generator_decides_and_orientations_vary():
    views = Views(MESHES)
    a, b, c = (views.view(0, np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(a.partial, b.partial)
    assert not np.allclose(a.pose[:3, :3], c.pose[:3, :3], atol=0.05)
    fresh = Views(MESHES)  # whatever was viewed before
    np.testing.assert_array_equal(fresh.view(0, np.random.default_rng(1)).partial, c.partial)


@pytest.mark.parametrize("name", ["occluded", "sensed", "jitter"])
def test_disturbances_are_there_when_asked_for(name):
    plain, disturbed = Views(MESHES, CLEAN), Views(MESHES, replace(CLEAN, **{name: 1.0}, hidden=(0.3, 0.3)))
    gaps, counts = [], []
    for seed in range(10):
        a, b = (v.view(1, np.random.default_rng(seed)) for v in (plain, disturbed))
        np.testing.assert_array_equal(a.pose, b.pose)
        counts.append(len(b.partial) / len(a.partial))
        gaps.append(cKDTree(a.partial).query(b.partial)[0].mean())
    if name == "occluded":
        assert 0.65 < np.mean(counts) < 0.75 and np.max(gaps) == 0
    else:
        assert 0.002 < np.mean(gaps) < 0.06


def test_batches_are_in_the_viewers_frame():
    batch = Views(MESHES, CLEAN).batch(np.random.default_rng(0), 6, 128, 256)
    assert batch.partial.shape == (6, 128, 3) and batch.target.shape == (6, 256, 3)
    assert batch.partial.norm(dim=-1).max() < 1.3
    hidden = batch.target[..., 2].mean(1) - batch.partial[..., 2].mean(1)
    assert (hidden > 0).all()  # what is not seen lies behind


def test_a_viewers_frame_is_rigid_but_for_its_unit_and_ignores_the_density():
    rng = np.random.default_rng(0)
    points = (rng.normal(size=(400, 3)) * [0.1, 0.05, 0.02] + [0.4, 0.1, 0.2]).astype(np.float32)
    frame = ViewerFrame.of(points, np.array([0.5, -1.0, 1.0]))
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(frame.leave(frame.enter(points)), points, atol=1e-6)
    assert np.linalg.norm(frame.enter(points[:64]), axis=1).max() == pytest.approx(1.0, abs=1e-5)
    eye = frame.enter(np.array([0.5, -1.0, 1.0]))
    np.testing.assert_allclose(eye[:2], 0.0, atol=1e-5)
    assert eye[2] < 0


def test_an_object_that_no_view_shows_is_named():
    needle = trimesh.creation.box((1.0, 1e-4, 1e-4))
    with pytest.raises(PwmGymError, match="mesh 0 shows fewer than 32 points in 100 views"):
        Views([needle], CLEAN).view(0, np.random.default_rng(0))


def test_bad_input_is_named():
    with pytest.raises(PwmGymError, match="no meshes to view"):
        Views([])
    with pytest.raises(PwmGymError, match="expected the camera outside"):
        ViewerFrame.of(np.random.default_rng(0).normal(size=(64, 3)), np.zeros(3))
    with pytest.raises(PwmGymError, match="partial cloud of radius 0 m"):
        ViewerFrame.of(np.ones((64, 3)), np.zeros(3))
