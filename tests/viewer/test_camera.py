import numpy as np
import pytest

from pwm_gym.errors import PwmGymError
from pwm_gym.viewer import Camera, frame_camera, tabletop_camera


def test_project_is_a_pinhole():
    camera = Camera(eye=(1.0, 0.0, 0.0), target=(0.0, 0.0, 0.0), fov=60.0, width=400, height=300)
    focal = 150 / np.tan(np.radians(30))  # looking along -x: right is +y, down is -z
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.2], [-1.0, -0.3, -0.2], [0.5, 0.1, 0.0]])
    depth = 1 - points[:, 0]
    expected = np.stack([200 + focal * points[:, 1] / depth, 150 - focal * points[:, 2] / depth, depth], 1)
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-9)


def test_project_marks_what_is_behind():
    camera = Camera(eye=(1.0, 0.0, 0.0), target=(0.0, 0.0, 0.0))
    seen = camera.project(np.array([[2.0, 0.1, 0.1], [0.0, 0.1, 0.1]]))
    assert np.isnan(seen[0, :2]).all()
    assert np.isfinite(seen[1]).all()


def test_rays_go_through_pixel_centres():
    camera = Camera(eye=(1.0, -0.7, 0.6), target=(0.6, 0.0, 0.1), width=7, height=5)
    points = np.array(camera.eye) + 1.3 * camera.rays().reshape(-1, 3)
    x, y = np.meshgrid(np.arange(7) + 0.5, np.arange(5) + 0.5)
    expected = np.stack([x.ravel(), y.ravel(), np.full(35, 1.3)], 1)
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-9)


@pytest.mark.parametrize("size", [(320, 320), (640, 200), (100, 300)])
def test_frame_camera_sees_every_point(size):
    width, height = size
    cloud = np.random.default_rng(1).normal([0.6, 0.1, 0.3], [0.1, 0.3, 0.1], (4, 500, 3))
    seen = frame_camera(cloud, width=width, height=height).project(cloud.reshape(-1, 3))
    assert (seen[:, :2] > 0).all()
    assert (seen[:, :2] < [width, height]).all()
    across = np.ptp(seen[:, :2], axis=0) / [width, height]
    assert across.max() > 0.6, "the cloud should fill the image in one direction"


def test_tabletop_camera_sees_the_work_area():
    corners = np.array([[x, y, z] for x in (0.45, 0.8) for y in (-0.2, 0.2) for z in (0.0, 0.35)])
    seen = tabletop_camera().project(corners)
    assert ((seen[:, :2] > 0) & (seen[:, :2] < 320)).all()


@pytest.mark.parametrize("cloud", [np.zeros((0, 3)), np.full((5, 3), 0.5)])
def test_frame_camera_of_degenerate_clouds(cloud):
    assert np.isfinite(frame_camera(cloud).project(np.full((1, 3), 0.5))).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fov": 180.0}, "fov=180.0"),
        ({"width": 0}, "0 x 320"),
        ({"target": (0.0, 0.0, 1.0)}, "along the line of sight"),
    ],
)
def test_impossible_cameras_are_errors(change, message):
    arguments = {"eye": (0.0, 0.0, 2.0), "target": (1.0, 0.0, 0.0), **change}
    with pytest.raises(PwmGymError, match=message):
        Camera(**arguments)
