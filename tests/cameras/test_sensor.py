import numpy as np
import pytest

from pwm_gym.cameras import DepthCamera
from pwm_gym.cameras.sensor import SENSORS, SensorModel, get_sensor, surface_normals
from pwm_gym.errors import PwmGymError, UnknownNameError

CAMERA = DepthCamera.looking((1.0, 0.0, 0.5), (0.0, 0.0, 0.2), fov=42.0)
NARROW = DepthCamera.looking((1.0, 0.0, 0.5), (0.0, 0.0, 0.2), fov=4.0)  # one angle of incidence for all pixels
GAIN = SENSORS["d455"].focal * SENSORS["d455"].baseline  # pixels x metres
SCALE = CAMERA.intrinsics[0, 0] / SENSORS["d455"].focal  # pixels of CAMERA in one of the real camera


def wall(distance):
    return np.full((128, 128), distance)


def step():
    """Two walls: 0.8 m in columns 0 to 63, 1.2 m in the others."""
    return np.where(np.arange(128) < 64, 0.8, 1.2) * np.ones((128, 1))


def plane(camera, degrees):
    """Depth of a plane 1 m away at the image's centre, turned about the image's vertical, and its normal."""
    angle = np.deg2rad(degrees)
    normal = camera.pose[:3, :3] @ [np.sin(angle), 0.0, -np.cos(angle)]
    return -np.cos(angle) / (camera.rays() @ normal), normal


def sensed(depth, camera=CAMERA, seed=0, **fields):
    return SensorModel(**fields).apply(depth, camera, np.random.default_rng(seed))


def test_noise_grows_with_the_square_of_depth_and_has_the_predicted_size():
    for distance in (0.7, 1.4, 2.8):
        error = sensed(wall(distance), subpixel=0.08, window=2.0) - distance
        np.testing.assert_allclose(error.std(), distance**2 * 0.08 / GAIN, rtol=0.05)
        assert abs(error.mean()) < 0.1 * error.std()


def test_noise_is_correlated_over_the_window():
    for window, low, high in ((0.0, -0.03, 0.03), (2.0, 0.6, 0.75)):
        error = sensed(wall(1.0), subpixel=0.08, window=window) - 1.0
        assert low < np.corrcoef(error[:, :-1].ravel(), error[:, 1:].ravel())[0, 1] < high
        assert abs(np.corrcoef(error[:, :-10].ravel(), error[:, 10:].ravel())[0, 1]) < 0.05


def test_disparity_is_quantised():
    depth = np.linspace(0.9, 1.1, 128 * 128).reshape(128, 128)
    measured = sensed(depth, step=1 / 32)
    steps = 32 * GAIN / measured
    np.testing.assert_allclose(steps, steps.round(), atol=1e-3)
    assert np.abs(measured - depth).max() <= 1.01 * 1.1**2 / (64 * GAIN)
    assert len(np.unique(measured)) == pytest.approx(32 * GAIN * (1 / 0.9 - 1 / 1.1), abs=2)


def test_flying_pixels_lie_between_the_surfaces_and_only_at_the_edge():
    depth = step()
    measured = sensed(depth, flying=1.0)
    flew = np.abs(measured - depth) > 1e-6
    assert flew[:, 63:65].mean() > 0.99 and not flew[:, :63].any() and not flew[:, 65:].any()
    assert (measured[flew] > 0.8).all() and (measured[flew] < 1.2).all()
    assert np.histogram(measured[flew], bins=4, range=(0.8, 1.2))[0].min() > 20
    flew = np.abs(sensed(depth, flying=0.5) - depth) > 1e-6
    assert 0.4 < flew[:, 63:65].mean() < 0.6


def test_nothing_flies_on_a_slanted_plane_or_before_an_empty_background():
    depth, _ = plane(CAMERA, 60.0)
    np.testing.assert_allclose(sensed(depth, flying=1.0, jump=0.2)[1:-1, 1:-1], depth[1:-1, 1:-1], rtol=1e-6)
    alone = np.where(np.arange(128) < 64, 0.8, 0.0) * np.ones((128, 1))
    np.testing.assert_allclose(sensed(alone, flying=1.0), alone, rtol=1e-6)


def test_grazing_surfaces_lose_more_pixels_than_frontal_ones():
    lost = [np.mean(sensed(plane(NARROW, a)[0], NARROW, grazing=(70.0, 88.0)) == 0) for a in (0.0, 60.0, 79.0, 84.0)]
    np.testing.assert_allclose(lost, [0.0, 0.0, 9 / 18, 14 / 18], atol=0.05)


def test_dropout_loses_its_share_in_blobs_as_large_as_the_window():
    lost = sensed(wall(1.0), dropout=0.1, window=4.0) == 0
    assert lost.mean() == pytest.approx(0.1, abs=0.02)
    assert lost[:, 1:][lost[:, :-1]].mean() > 0.4  # the next pixel's chance; 0.1 without correlation


def test_the_shadow_is_left_of_what_stands_in_front_and_as_wide_as_the_disparity_jump():
    depth = wall(1.2)
    depth[40:80, 60:90] = 0.8
    lost = sensed(depth, shadow=True) == 0
    width = GAIN * (1 / 0.8 - 1 / 1.2) * SCALE  # 7 pixels
    assert not lost[:40].any() and not lost[80:].any() and not lost[:, 60:].any()
    np.testing.assert_allclose(lost[40:80].sum(1), width, atol=1.0)
    assert lost[40:80, 60 - int(width) : 60].all()


def test_depth_outside_the_range_is_not_measured():
    depth = np.linspace(0.2, 8.0, 128) * np.ones((128, 1))
    measured = sensed(depth, near=0.5, far=6.0)
    np.testing.assert_allclose(measured, np.where((depth >= 0.5) & (depth <= 6.0), depth, 0.0), rtol=1e-6)


def test_the_ideal_sensor_changes_nothing():
    depth = plane(CAMERA, 65.0)[0].astype(np.float32)
    depth[:10], depth[10:20], depth[20:30] = 0.0, np.nan, np.inf
    before = depth.copy()
    measured = get_sensor("ideal").apply(depth, CAMERA, np.random.default_rng(0))
    assert measured.dtype == np.float32 and (measured[:30] == 0).all()
    np.testing.assert_array_equal(measured[30:], depth[30:])
    np.testing.assert_array_equal(depth, before)


def test_the_generator_decides_the_errors():
    first, again, other = (get_sensor("d455").apply(step(), CAMERA, np.random.default_rng(s)) for s in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5


def test_the_d455_keeps_to_its_data_sheet():
    sensor = get_sensor("d455")
    assert sensor.near == pytest.approx(0.34, abs=0.01)  # metres, at 848 x 480
    measured = sensor.apply(wall(4.0), CAMERA, np.random.default_rng(0))
    valid = measured > 0
    assert valid.mean() > 0.97
    assert 0.005 < np.sqrt(np.mean((measured[valid] / 4.0 - 1.0) ** 2)) < 0.02  # better than 2 % at 4 m
    for distance in (0.3, 6.3):
        assert not sensor.apply(wall(distance), CAMERA, np.random.default_rng(0)).any()


def test_normals_of_planes_are_exact_even_beside_a_depth_edge():
    depth, normal = plane(CAMERA, 50.0)
    depth[30:60, 30:60] = 0.5
    normals = surface_normals(depth, CAMERA)
    slanted = np.ones((128, 128), bool)
    slanted[30:60, 30:60] = False
    np.testing.assert_allclose(normals[slanted], np.broadcast_to(normal, (slanted.sum(), 3)), atol=1e-9)
    np.testing.assert_allclose(normals[40, 40], -CAMERA.pose[:3, 2], atol=1e-9)
    lone = np.zeros((128, 128))
    lone[5, 5] = 1.0
    assert not surface_normals(lone, CAMERA).any()


def test_bad_input_is_named():
    with pytest.raises(PwmGymError, match=r"depth has shape \(3, 3\); expected \(128, 128\)"):
        get_sensor("d455").apply(np.ones((3, 3)), CAMERA, np.random.default_rng(0))
    with pytest.raises(UnknownNameError, match="unknown sensor 'd445'; known: d455, ideal. Did you mean 'd455'"):
        get_sensor("d445")
    for fields, message in (
        ({"dropout": 1.5}, "dropout is 1.5; expected a share from 0 to 1"),
        ({"subpixel": -0.1}, "subpixel is -0.1; expected 0 or more"),
        ({"baseline": 0.0}, "baseline 0.0; expected positive"),
        ({"near": 2.0, "far": 1.0}, "the range is 2.0 to 1.0 metres"),
    ):
        with pytest.raises(PwmGymError, match=message):
            SensorModel(**fields)
