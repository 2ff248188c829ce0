from time import process_time

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pwm_gym.cameras import DepthCamera, RayCaster
from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.perception.tracking import Registration, Tracker, TrackingConfig, register
from pwm_gym.scene import Layout, sample_surface

CAMERA = DepthCamera.looking((0.9, -0.45, 0.55), (0.45, 0.0, 0.12), fov=40.0)
EYE = CAMERA.pose[:3, 3]
NOISE = 0.002  # metres, of each pixel's depth
LAYOUT = Layout.build([("hook", 300), ("cube", 300)])


def hook():
    """An L of unequal legs, which no rotation takes to itself: 9 x 6 x 4 cm."""
    outline = np.array([(0, 0), (9, 0), (9, 2.5), (3, 2.5), (3, 6), (0, 6)]) / 100 - (0.045, 0.03)
    fan = np.array([(3, 4, 5), (3, 5, 0), (3, 0, 1), (3, 1, 2)])  # from the inner corner
    here = np.arange(6)
    after = (here + 1) % 6
    sides = np.concatenate([np.stack([here, after, after + 6], 1), np.stack([here, after + 6, here + 6], 1)])
    vertices = np.concatenate([np.c_[outline, np.full(6, z)] for z in (-0.02, 0.02)])
    return trimesh.Trimesh(vertices, np.concatenate([fan[:, ::-1], fan + 6, sides]))


MESHES = {"hook": hook(), "cube": trimesh.creation.box((0.04, 0.04, 0.04))}
CASTER = RayCaster(MESHES, LAYOUT, table=False)


@pytest.fixture(scope="module")
def clouds():
    assert MESHES["hook"].is_watertight
    return {name: sample_surface(mesh, 300, 0) for name, mesh in MESHES.items()}


def place(x, y, z, turn=(0.0, 0.0, 0.0)):
    """Pose (4, 4); the turn is a rotation vector in degrees."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn, degrees=True).as_matrix()
    pose[:3, 3] = x, y, z
    return pose


def path(frames=30):
    """Poses (T, 2, 4, 4): the hook circles, the cube rises; both turn by 4 degrees a frame, about changing axes."""
    poses = []
    hook, cube = place(0.37, 0.0, 0.12, (20, -15, 30)), place(0.52, 0.05, 0.05, (10, 20, 0))
    for t in np.linspace(0, 2 * np.pi, frames):
        poses.append(np.stack([hook, cube]))
        hook, cube = hook.copy(), cube.copy()
        hook[:3, 3] += 0.007 * np.array([np.cos(t), np.sin(t), 0.3 * np.sin(2 * t)])
        cube[:3, 3] += 0.006 * np.array([0.2, np.sin(t), 0.6])
        axis = np.array([np.sin(t), np.cos(t), 1.0]) / 2**0.5
        turn = Rotation.from_rotvec(4 * axis, degrees=True).as_matrix()
        hook[:3, :3], cube[:3, :3] = turn @ hook[:3, :3], turn.T @ cube[:3, :3]
    return np.array(poses)


def look(poses, rng, noise=NOISE, count=300):
    """What the camera sees (m, 3) of each entity, at most ``count`` points, with noise along its line of sight."""
    view = CASTER.view(CAMERA, poses)
    points = CAMERA.back_project(view.depth + noise * rng.standard_normal(view.depth.shape))
    seen = {name: points[view.segmentation == i] for i, name in enumerate(LAYOUT.names)}
    return {name: rng.permutation(part)[:count] for name, part in seen.items()}


def errors(poses, truth):
    """Distances (E,) in millimetres and angles (E,) in degrees between poses and the true ones (E, 4, 4)."""
    found = np.stack([poses[name] for name in LAYOUT.names])
    turn = Rotation.from_matrix(found[:, :3, :3].transpose(0, 2, 1) @ truth[:, :3, :3]).magnitude()
    return 1e3 * np.linalg.norm(found[:, :3, 3] - truth[:, :3, 3], axis=1), np.rad2deg(turn)


def follow(clouds, truth, eye=None, change=lambda t, partials: partials):
    """Errors (T, 2, E), and milliseconds (T,) a view, of a tracker that sees a path."""
    rng, found, times = np.random.default_rng(0), [], []
    tracker = Tracker(clouds, dict(zip(LAYOUT.names, truth[0], strict=True)))
    for t, poses in enumerate(truth):
        partials = change(t, look(poses, rng))
        start = process_time()
        found.append(errors(tracker.update(partials, eye=eye), poses))
        times.append(1e3 * (process_time() - start))
    return np.array(found), np.array(times)


@pytest.mark.parametrize("eye", [None, EYE], ids=["blind", "eye"])
def test_follows_a_path_from_one_side(clouds, eye):
    found, times = follow(clouds, path(), eye)
    millimetres, degrees = found[:, 0], found[:, 1]
    assert np.median(millimetres) < 0.8 and millimetres.max() < 5
    assert np.median(degrees[:, 0]) < 1.5 and np.median(degrees[:, 1]) < 2.5
    assert degrees.max() < 8  # of a cube of which a view shows 60 points on two faces
    assert np.median(times) < 60  # of both; 10 without and 16 with an eye on a busy machine


def test_a_hidden_entity_keeps_its_pose_and_is_found_again(clouds):
    truth = path()
    found, _ = follow(clouds, truth, EYE, lambda t, seen: {} if 10 <= t < 15 else seen)
    assert found[14, 0].min() > 15  # millimetres: they went on meanwhile
    assert found[15:, 0].max() < 5 and found[15:, 1].max() < 8

    tracker = Tracker(clouds, dict(zip(LAYOUT.names, truth[0], strict=True)))
    rng = np.random.default_rng(1)
    for poses in truth[:3]:
        tracker.update(look(poses, rng), eye=EYE)
    before, points = tracker.poses, tracker.points()
    few = {"cube": look(truth[3], rng)["cube"][:31]}
    after = tracker.update(few, eye=EYE)
    assert tracker.registrations == {}
    for name in LAYOUT.names:
        np.testing.assert_array_equal(after[name], before[name])
        np.testing.assert_array_equal(tracker.points()[name], points[name])
        history = tracker.history(name)
        np.testing.assert_array_equal(history[0], history[1])
        assert np.abs(history[1] - history[2])[:3, 3].max() > 1e-3  # the last velocity that was seen


def test_a_neighbours_points_are_no_harm(clouds):
    rng = np.random.default_rng(2)

    def add(t, seen):
        """A fifth of each view lies on a wall 2 cm beside the entity."""
        for name, part in seen.items():
            wall = rng.uniform(-0.02, 0.02, (len(part) // 4, 3)) * (1, 0.05, 1)
            seen[name] = np.concatenate(
                [part, wall + part.mean(0) + (0, part[:, 1].max() - part[:, 1].mean() + 0.02, 0)]
            )
        return seen

    found, _ = follow(clouds, path(), EYE, add)
    assert np.median(found[:, 0]) < 1.2 and found[:, 0].max() < 8
    assert np.median(found[:, 1]) < 2.5 and found[:, 1].max() < 12


def test_points_elsewhere_are_not_believed(clouds):
    truth = path(1)[0]
    tracker = Tracker(clouds, dict(zip(LAYOUT.names, truth, strict=True)))
    plane = np.random.default_rng(0).uniform(-0.3, 0.3, (300, 3)) * (1, 1, 0)  # a table
    poses = tracker.update({"cube": plane}, eye=EYE)
    assert "cube" not in tracker.registrations
    np.testing.assert_array_equal(poses["cube"], truth[1])


def test_a_carried_entity_goes_with_the_gripper_while_it_is_hidden(clouds):
    truth = path(2)[0]
    tracker = Tracker(clouds, dict(zip(LAYOUT.names, truth, strict=True)))
    step = place(0.0, 0.0, 0.03) @ place(0.5, 0, 0) @ place(0, 0, 0, (0, 0, 30)) @ place(-0.5, 0, 0)
    for count in (1, 2):
        poses = tracker.update({}, carried_by={"cube": "hand"}, motion={"hand": step})
        np.testing.assert_allclose(poses["cube"], np.linalg.matrix_power(step, count) @ truth[1], atol=1e-12)
        np.testing.assert_array_equal(poses["hook"], truth[0])
    held = truth.copy()
    held[1] = place(0.001, 0, 0) @ step @ poses["cube"]  # and slips a little
    partials = look(held, np.random.default_rng(0))
    poses = tracker.update(partials, eye=EYE, carried_by={"cube": "hand"}, motion={"hand": step})
    millimetres, degrees = errors(poses, held)
    assert set(tracker.registrations) == {"hook", "cube"}
    assert millimetres.max() < 3 and degrees.max() < 5  # 30 degrees a step do not mislead it


def test_velocities_are_those_of_the_last_views(clouds):
    truth = path(3)
    tracker = Tracker(clouds, dict(zip(LAYOUT.names, truth[0], strict=True)))
    for poses in truth:
        tracker.update(look(poses, np.random.default_rng(0), noise=0.0))
    history = tracker.history("hook")
    assert history.shape == (3, 4, 4)
    np.testing.assert_allclose(history[:, :3, 3], truth[::-1, 0, :3, 3], atol=2e-3)
    tracker.track("hook", clouds["cube"], truth[0, 0])
    np.testing.assert_array_equal(tracker.history("hook"), np.repeat(truth[:1, 0], 3, 0))
    assert tracker.points()["hook"].shape == (300, 3)


def test_registers_one_view(clouds):
    truth = path(1)[0]
    partial = look(truth, np.random.default_rng(0))["hook"]
    guess = place(0.008, -0.006, 0.005) @ truth[0] @ place(0, 0, 0, (5, -6, 5))
    for eye in (None, EYE):
        fit = register(clouds["hook"], partial, guess, eye=eye)
        assert isinstance(fit, Registration) and fit.inliers > 0.98 and 0.5 * NOISE < fit.rms < 1.3 * NOISE
        millimetres, degrees = errors({"hook": fit.pose, "cube": truth[1]}, truth)
        assert millimetres[0] < 2 and degrees[0] < 2
        np.testing.assert_allclose(fit.pose[:3, :3] @ fit.pose[:3, :3].T, np.eye(3), atol=1e-9)
    far = register(clouds["hook"], partial, place(2, 2, 2))
    assert far.inliers == 0 and far.rms == np.inf


def test_the_eye_tells_the_sides_of_a_plate_apart():
    plate = trimesh.creation.box((0.12, 0.09, 0.012))
    cloud, truth = sample_surface(plate, 300, 0), place(0.45, 0.0, 0.1, (10, 5, 20))
    view = RayCaster({"plate": plate}, Layout.build([("plate", 300)]), table=False).view(CAMERA, truth[None])
    partial = CAMERA.back_project(view.depth)[view.segmentation == 0][::2]
    guess = place(0, 0, 0.012) @ truth  # its lower side is where the upper one is
    gap = {eye is None: register(cloud, partial, guess, eye=eye).pose[2, 3] - truth[2, 3] for eye in (None, EYE)}
    assert abs(gap[False]) < 2e-3 < 8e-3 < abs(gap[True])


def test_flat_clouds_and_large_views_are_registered(clouds):
    rng = np.random.default_rng(0)
    sheet = rng.uniform(-0.1, 0.1, (200, 3)) * (1, 1, 0)
    for eye in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)):  # from above, and edge-on
        fit = register(sheet, sheet + (0, 0, 0.003), np.eye(4), eye=np.array(eye))
        assert fit.pose[2, 3] == pytest.approx(0.003, abs=1e-4)
        assert np.abs(fit.pose[:2, 3]).max() < 3e-3  # along the sheet only its rim tells
    tracker = Tracker(clouds, {name: np.eye(4) for name in clouds}, TrackingConfig(max_points=100))
    assert tracker.update({"cube": np.repeat(clouds["cube"], 50, 0)})["cube"] == pytest.approx(np.eye(4), abs=1e-3)


def test_bad_input_is_told(clouds):
    poses = {name: np.eye(4) for name in clouds}
    tracker = Tracker(clouds, poses)
    cases = {
        r"the cloud of 'a' has shape \(7, 3\)": lambda: tracker.track("a", clouds["cube"][:7], np.eye(4)),
        r"the pose of 'a' has shape \(7,\); expected \(4, 4\)": lambda: tracker.track("a", clouds["cube"], np.ones(7)),
        "a cloud has 1 different points; expected at least 8": lambda: tracker.track("a", np.ones((9, 3)), np.eye(4)),
        r"the eye is at \[1, 2\]": lambda: tracker.update({"cube": clouds["cube"]}, eye=[1, 2]),
        "the guess is not rigid": lambda: register(clouds["cube"], clouds["cube"], 2 * np.eye(4)),
        "the view holds 1 values that are not": lambda: register(
            clouds["cube"], [[np.nan, 0, 0]] + [[0, 0, 0]] * 8, np.eye(4)
        ),
        r"the view of 'cube' has shape \(40, 2\)": lambda: tracker.update({"cube": np.zeros((40, 2))}),
        r"the motion of 'hand' has shape \(3,\)": lambda: tracker.update(
            {}, carried_by={"cube": "hand"}, motion={"hand": np.ones(3)}
        ),
    }
    for message, call in cases.items():
        with pytest.raises(PwmGymError, match=message):
            call()
    unknown = {
        "unknown entity 'cub'; known: cube, hook. Did you mean 'cube'": lambda: tracker.update(
            {"cub": np.zeros((40, 3))}
        ),
        "unknown entity 'ball'": lambda: tracker.update({}, carried_by={"ball": "hand"}, motion={"hand": np.eye(4)}),
        "unknown motion 'hand'; known: none": lambda: tracker.update({}, carried_by={"cube": "hand"}),
        "unknown entity 'ball'; known": lambda: tracker.history("ball"),
        "unknown pose 'cube'; known: hook": lambda: Tracker(clouds, {"hook": np.eye(4)}),
    }
    for message, call in unknown.items():
        with pytest.raises(UnknownNameError, match=message):
            call()
