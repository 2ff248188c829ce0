import numpy as np
import pytest
import trimesh
from scipy import ndimage

from pwm_gym.cameras import DepthCamera, RayCaster
from pwm_gym.cameras.sensor import get_sensor
from pwm_gym.errors import PwmGymError
from pwm_gym.perception.cleaning import Cleaning, clean, clusters, depth_edges, inliers, median_depth
from pwm_gym.scene import Layout

CAMERA = DepthCamera.looking((0.95, 0.0, 0.5), (0.0, 0.0, 0.1), fov=42.0)
LAYOUT = Layout.build([("ball", 100), ("box", 100), ("rod", 100), ("wall", 100)])
PLACES = np.array([[0.0, -0.2, 0.1], [0.0, 0.12, 0.08], [0.15, -0.02, 0.175], [-0.6, 0.0, 0.5]])
ONLY_BACK_PROJECT = Cleaning(edge_jump=0, erosion=0, median=0, neighbours=0, cluster=0)


@pytest.fixture(scope="module")
def view():
    """A ball, a box and a rod 2.4 cm thick, all in front of a wall."""
    meshes = {
        "ball": trimesh.creation.icosphere(4, 0.1),
        "box": trimesh.creation.box((0.2, 0.12, 0.16)),
        "rod": trimesh.creation.cylinder(0.012, 0.35),
        "wall": trimesh.creation.box((0.02, 3.0, 2.0)),
    }
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, 3] = PLACES
    return RayCaster(meshes, LAYOUT).view(CAMERA, poses)


def error(points, entity):
    """Distance (m,) of points to the true surface of the ball, the box or the rod."""
    local = points - PLACES[entity]
    if entity == 0:
        return np.abs(np.linalg.norm(local, axis=1) - 0.1)
    if entity == 1:
        beyond = np.abs(local) - [0.1, 0.06, 0.08]
    else:
        beyond = np.stack([np.linalg.norm(local[:, :2], axis=1) - 0.012, np.abs(local[:, 2]) - 0.175], 1)
    return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) - np.minimum(beyond.max(1), 0.0)


def ramp(degrees):
    """Depth of a plane 1 m away at the image's centre, turned about the vertical."""
    angle = np.deg2rad(degrees)
    normal = CAMERA.pose[:3, :3] @ [np.sin(angle), 0.0, -np.cos(angle)]
    return -np.cos(angle) / (CAMERA.rays() @ normal)


def block(rows, columns):
    mask = np.zeros((128, 128), bool)
    mask[rows, columns] = True
    return mask


@pytest.mark.parametrize("entity", [0, 1, 2])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_cleaning_brings_sensed_points_to_the_true_surface(view, entity, seed):
    depth = get_sensor("d455").apply(view.depth, CAMERA, np.random.default_rng(seed))
    mask = ndimage.binary_dilation(view.segmentation == entity)  # segmenters spill over by a pixel
    before = np.percentile(error(clean(depth, mask, CAMERA, ONLY_BACK_PROJECT), entity), 95)
    points = clean(depth, mask, CAMERA)
    after = np.percentile(error(points, entity), 95)
    assert after < 0.004 and after < before / 10
    assert len(points) > 0.7 * (view.segmentation == entity).sum()
    assert points.dtype == np.float32 and points.shape[1] == 3


def test_ideal_depth_of_the_true_mask_stays_on_the_surface(view):
    points = clean(view.depth, view.segmentation == 0, CAMERA)
    assert error(points, 0).max() < 2e-3 and len(points) > 0.8 * (view.segmentation == 0).sum()


def test_each_step_is_left_out_by_zero(view):
    mask = view.segmentation == 1
    points = clean(view.depth, mask, CAMERA, ONLY_BACK_PROJECT)
    np.testing.assert_allclose(points, CAMERA.back_project(view.depth)[mask], atol=1e-6)


def test_edges_are_the_pixels_behind_a_jump_and_slanted_planes_have_none():
    depth = np.where(np.arange(128) < 64, 0.8, 1.2) * np.ones((128, 1))
    depth[:, 64] = 1.0  # flies
    edges = depth_edges(depth, CAMERA, 0.03, 30.0)
    assert edges[:, 64].all() and edges[:, 65].all() and edges.sum() == 2 * 128
    slanted = ramp(65.0)
    assert (np.diff(slanted, axis=1) / slanted[:, 1:] > 0.01).mean() > 0.4
    assert not depth_edges(slanted, CAMERA, 0.01, 30.0).any()


def test_erosion_takes_the_outline_of_thick_objects_only():
    config = Cleaning(edge_jump=0, median=0, neighbours=0, cluster=0)
    depth = np.full((128, 128), 1.0)
    assert len(clean(depth, block(slice(20, 60), slice(30, 90)), CAMERA, config)) == 38 * 58
    assert len(clean(depth, block(slice(20, 40), slice(30, 60)), CAMERA, config)) == 20 * 30  # a sixth of it is outline
    assert len(clean(depth, block(slice(20, 40), slice(30, 32)), CAMERA, config)) == 20 * 2
    assert len(clean(depth, block(slice(0, 40), slice(0, 60)), CAMERA, config)) == 39 * 59  # cut by the image's border


def test_thin_objects_lose_what_flies_but_not_their_outline():
    depth, mask = np.full((128, 128), 1.2), block(slice(20, 60), slice(30, 33))
    depth[20:60, 30:32], depth[20:60, 32] = 0.8, 1.0
    points = clean(depth, mask, CAMERA, Cleaning(median=0, neighbours=0, cluster=0))
    np.testing.assert_allclose(CAMERA.project(points)[:, 2], np.full(80, 0.8), rtol=1e-6)


def test_the_median_takes_spikes_and_sees_nothing_outside_the_mask():
    depth, mask = np.full((128, 128), 1.0), block(slice(20, 40), slice(30, 60))
    depth[~mask], depth[30, 45], depth[25, 40] = 9.0, 1.3, 0.0
    filtered = median_depth(depth, mask, 3)
    assert (filtered[~mask] == 9.0).all() and filtered[25, 40] == 0.0
    assert (filtered[mask & (depth > 0)] == 1.0).all()


def test_the_median_does_not_bend_a_slanted_plane_at_the_mask_outline():
    depth, mask = ramp(60.0), block(slice(20, 40), slice(30, 60))
    np.testing.assert_allclose(median_depth(depth, mask, 3)[mask], depth[mask], rtol=2e-3)
    assert np.abs(np.diff(depth, axis=1))[mask[:, 1:]].min() > 5e-3  # what half a window would be off by


def test_lone_points_are_outliers():
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(15), [0.0]), -1).reshape(-1, 3) * 0.005
    lone = np.array([[0.05, 0.03, 0.1], [0.2, 0.2, 0.0]])
    kept = inliers(np.concatenate([grid, lone]), 12, 2.5)
    assert kept[:-2].all() and not kept[-2:].any()


def test_small_clusters_are_dropped():
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(10), [0.0]), -1).reshape(-1, 3) * 0.005
    points = np.concatenate([grid, grid[:30] + [0.2, 0, 0], grid[:10] + [0, 0, 0.2]])
    for share, count in ((0.0, 140), (0.2, 130), (1.0, 100)):
        kept = clusters(points, 3.0, share)
        assert kept[:count].all() and not kept[count:].any()


def test_what_is_not_finite_counts_as_no_measurement(view):
    mask = view.segmentation == 0
    holes, others = view.depth.copy(), view.depth.copy()
    holes[::7] = 0.0
    others[::14], others[7::14] = np.nan, np.inf
    np.testing.assert_array_equal(clean(others, mask, CAMERA), clean(holes, mask, CAMERA))


MASK = block(slice(20, 40), slice(30, 60))
DEPTH = np.full((128, 128), 1.0)


@pytest.mark.parametrize(
    ("depth", "mask", "message"),
    [
        (DEPTH, np.zeros((128, 128), bool), "the mask has no pixel"),
        (DEPTH, MASK[:64], r"the mask has shape \(64, 128\); expected the camera's \(128, 128\)"),
        (DEPTH[:, :9], MASK, r"the depth has shape \(128, 9\); expected the camera's \(128, 128\)"),
        ((1000 * DEPTH).astype(np.uint16), MASK, "the median depth is 1000 m: this looks like millimetres"),
        (np.where(MASK, np.nan, DEPTH), MASK, "none of the mask's 600 pixels has a depth"),
        (DEPTH, block(slice(20, 24), slice(20, 27)), "28 points are left after cleaning, of 28 pixels in the mask"),
    ],
    ids=["empty", "mask shape", "depth shape", "millimetres", "no depth", "few"],
)
def test_bad_images_are_named(depth, mask, message):
    with pytest.raises(PwmGymError, match=message):
        clean(depth, mask, CAMERA, Cleaning(erosion=0, edge_jump=0))


def test_bad_settings_are_named():
    with pytest.raises(PwmGymError, match="median is 4; expected an odd number"):
        Cleaning(median=4)
    with pytest.raises(PwmGymError, match="spread is -1; expected 0 or more"):
        Cleaning(spread=-1)
