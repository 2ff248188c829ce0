import timeit

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pwm_gym.cameras import DepthCamera, RayCaster
from pwm_gym.cameras.viewpoints import VIEWPOINTS
from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.scene import Layout, batch_state
from pwm_gym.tasks import get_task

LAYOUT = Layout.build([("ball", 200), ("box", 200)])
CAMERA = DepthCamera.looking((1.0, -0.2, 0.8), (0.0, 0.0, 0.1), fov=40.0, width=96, height=64)


@pytest.fixture
def meshes():
    return {"ball": trimesh.creation.icosphere(4, 0.1), "box": trimesh.creation.box((0.2, 0.1, 0.06))}


@pytest.fixture
def poses():
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[0, :3, 3] = [0.0, 0.0, 0.1]
    poses[1, :3, :3] = Rotation.from_euler("z", 0.7).as_matrix()
    poses[1, :3, 3] = [-0.1, 0.25, 0.03]
    return poses


@pytest.fixture
def caster(meshes):
    return RayCaster(meshes, LAYOUT)


def test_projection_and_back_projection_are_inverse():
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 3))
    image = CAMERA.project(points)
    rays = image[:, :2].round().astype(int)
    assert (image[:, 2] > 0.3).all() and (rays >= 0).all()
    depth = np.linspace(0.5, 2.0, 64 * 96).reshape(64, 96)
    again = CAMERA.project(CAMERA.back_project(depth))
    u, v = np.meshgrid(np.arange(96), np.arange(64))
    np.testing.assert_allclose(again, np.stack([u, v, depth], -1), atol=1e-9)
    centre = CAMERA.project(np.array([[0.0, 0.0, 0.1]]))[0]
    np.testing.assert_allclose(centre[:2], [47.5, 31.5], atol=1e-9)


def test_depth_is_that_of_the_analytic_shapes(caster, poses):
    view = caster.view(CAMERA, poses)
    points = CAMERA.back_project(view.depth)
    radius = np.linalg.norm(points - poses[0, :3, 3], axis=-1)
    np.testing.assert_allclose(radius[view.segmentation == 0], 0.1, atol=5e-4)
    local = (points - poses[1, :3, 3]) @ poses[1, :3, :3]
    beyond = np.abs(local) - np.array([0.1, 0.05, 0.03])
    np.testing.assert_allclose(beyond[view.segmentation == 1].max(-1), 0.0, atol=1e-5)
    np.testing.assert_allclose(points[view.segmentation == -1][:, 2], 0.0, atol=1e-6)
    assert {int(k) for k in np.unique(view.segmentation)} == {-1, 0, 1}


def test_the_background_has_no_depth(meshes, poses):
    view = RayCaster(meshes, LAYOUT, table=False).view(CAMERA, poses)
    assert (view.depth[view.segmentation == -2] == 0).all() and (view.segmentation == -2).mean() > 0.5
    assert (view.depth[view.segmentation >= 0] > 0).all()


def test_points_that_face_the_camera_are_seen_and_those_behind_are_not(caster, meshes, poses):
    normals = trimesh.creation.icosphere(3).vertices
    ball = 0.1 * normals + poses[0, :3, 3]
    seen = caster.visible(CAMERA, ball, poses)
    towards = CAMERA.pose[:3, 3] - ball
    facing = (normals * towards).sum(1) / np.linalg.norm(towards, axis=1)
    assert seen[facing > 0.15].all() and not seen[facing < -0.3].any()
    far = ball + [0.0, 3.0, 0.0]  # outside the image
    assert not caster.visible(CAMERA, far, poses).any()


def test_one_entity_hides_another(caster, poses):
    top = np.array([[-0.1, 0.25, 0.06]])
    assert caster.visible(CAMERA, top, poses).all()
    hiding = poses.copy()
    hiding[0, :3, 3] = 0.5 * (CAMERA.pose[:3, 3] + top[0])
    assert not caster.visible(CAMERA, top, hiding).any()


def test_bad_cameras_and_scenes_are_named(meshes):
    with pytest.raises(PwmGymError, match=r"intrinsics have shape \(2, 2\)"):
        DepthCamera(np.eye(2), np.eye(4))
    with pytest.raises(PwmGymError, match="focal lengths are -1.0 and 1.0"):
        DepthCamera(np.diag([-1.0, 1.0, 1.0]), np.eye(4))
    with pytest.raises(PwmGymError, match="not rigid"):
        DepthCamera(np.eye(3), np.diag([2.0, 1.0, 1.0, 1.0]))
    with pytest.raises(PwmGymError, match=r"pose has shape \(3, 4\)"):
        DepthCamera(np.eye(3), np.eye(4)[:3])
    with pytest.raises(PwmGymError, match=r"depth has shape \(3, 3\); expected \(64, 96\)"):
        CAMERA.back_project(np.ones((3, 3)))
    with pytest.raises(SceneError, match="no mesh for box"):
        RayCaster({"ball": meshes["ball"]}, LAYOUT)


def test_thousands_of_casters_live_in_one_process():
    """Each shows its own object: one Embree device serves them all."""
    layout = Layout.build([("box", 8)])
    casters = [RayCaster({"box": trimesh.creation.box([0.1 + 1e-4 * k] * 3)}, layout, table=False) for k in range(2500)]
    looking = DepthCamera.looking((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), fov=2.0, width=3, height=3)
    for k in (0, 1300, 2499):
        depth = casters[k].view(looking, np.eye(4)[None]).depth
        assert depth[1, 1] == pytest.approx(1.0 - 0.5 * (0.1 + 1e-4 * k), abs=1e-5)


def test_a_view_of_robot_and_object_is_made_in_time(sim):
    """128 x 128 rays at a whole scene, in at most 50 ms."""
    sim.reset(seed=300_000)
    simulator = sim.unwrapped.simulator
    caster = RayCaster(simulator.meshes(), get_task("PickCube").layout)
    camera = VIEWPOINTS["right"]
    assert (camera.width, camera.height) == (128, 128)
    poses = batch_state([sim.unwrapped.scene()]).poses()[0].numpy()
    view = caster.view(camera, poses)
    assert {-1, 0, 3} <= set(np.unique(view.segmentation).tolist())
    seconds = min(timeit.repeat(lambda: caster.view(camera, poses), number=1, repeat=10))
    assert seconds < 0.05
