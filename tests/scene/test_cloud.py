import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from pwm_gym.errors import SceneError
from pwm_gym.scene import Layout, resample_clouds, sample_clouds, sample_surface, spread
from pwm_gym.scene.cloud import reordered

HALF = np.array([0.1, 0.05, 0.02])


@pytest.fixture(scope="module")
def box():
    return trimesh.creation.box(2 * HALF)


def covering_radius(chosen, surface):
    return cKDTree(chosen).query(surface)[0].max()


def test_points_lie_on_the_surface(box):
    cloud = sample_surface(box, 300, seed=0)
    assert cloud.shape == (300, 3) and cloud.dtype == np.float32
    depth = HALF - np.abs(cloud)  # to the nearest face
    assert np.abs(depth.min(1)).max() < 1e-6
    assert (depth > -1e-6).all()


@pytest.mark.parametrize("count", [16, 32, 128, 300])
def test_every_prefix_is_better_spread_than_chance(box, count):
    cloud = sample_surface(box, 300, seed=0)
    surface = trimesh.sample.sample_surface(box, 4000, seed=1)[0]
    by_chance = [covering_radius(trimesh.sample.sample_surface(box, count, seed=s)[0], surface) for s in range(2, 7)]
    assert covering_radius(cloud[:count], surface) < 0.85 * min(by_chance)


def test_the_seed_decides(box):
    a, b, c = (sample_surface(box, 50, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


def test_clouds_of_a_layout_and_their_coarser_form(box):
    layout = Layout.build([("box", 60), ("ball", 40)])
    meshes = {"ball": trimesh.creation.icosphere(3, 0.03), "box": box}
    clouds = sample_clouds(meshes, layout, seed=0)
    assert clouds.shape == (100, 3)
    np.testing.assert_allclose(np.linalg.norm(clouds[60:], axis=1), 0.03, atol=1e-3)
    coarse = resample_clouds(clouds, layout, layout.resize(10))
    np.testing.assert_array_equal(coarse, np.r_[clouds[:6], clouds[60:64]])


def test_a_missing_mesh_is_named(box):
    with pytest.raises(SceneError, match="no mesh for ball; got box"):
        sample_clouds({"box": box}, Layout.build([("box", 5), ("ball", 5)]), seed=0)


def test_spread_points_are_the_clouds_own_and_every_prefix_covers_it(box):
    points = trimesh.sample.sample_surface(box, 900, seed=3)[0].astype(np.float32)
    chosen = spread(points, 100)
    assert {tuple(p) for p in chosen} <= {tuple(p) for p in points} and len(np.unique(chosen, axis=0)) == 100
    for count in (20, 50, 100):
        assert covering_radius(chosen[:count], points) < 0.85 * covering_radius(points[:count], points)
    np.testing.assert_array_equal(spread(points, 100), chosen)


def test_fewer_points_than_asked_for_are_repeated():
    points = np.random.default_rng(0).normal(size=(40, 3)).astype(np.float32)
    more = spread(points, 100)
    assert more.shape == (100, 3) and len(np.unique(more[:40], axis=0)) == 40
    np.testing.assert_array_equal(more[40:80], more[:40])
    assert spread(points[:1], 3).shape == (3, 3)


def test_another_order_has_the_same_points_and_is_well_spread_from_where_it_starts(box):
    cloud = sample_surface(box, 300, seed=0)
    other = reordered(cloud, start=17, leading=64)
    np.testing.assert_array_equal(other[0], cloud[17])
    np.testing.assert_array_equal(np.sort(other.view("f4,f4,f4").ravel()), np.sort(cloud.view("f4,f4,f4").ravel()))
    assert len({*map(tuple, other[:32])} & {*map(tuple, cloud[:32])}) < 24
    for count in (32, 64):
        assert covering_radius(other[:count], cloud) < 1.2 * covering_radius(cloud[:count], cloud)
    assert reordered(cloud, start=0, leading=999).shape == cloud.shape
