from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.cameras import RayCaster
from pwm_gym.cameras.viewpoints import CAMERA
from pwm_gym.completion import Completion, HullCompleter
from pwm_gym.errors import SceneError
from pwm_gym.perception import Frame, IdSegmenter, MaskSegmenter, SceneObserver
from pwm_gym.perception.observer import _upright_frame
from pwm_gym.scene import Layout, batch_state, sample_clouds
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
VIEW = CAMERA.resize(2)


@pytest.fixture(scope="module")
def world():
    """The simulator with a ray caster on its meshes, and their clouds."""
    simulator = TASK.simulator()
    clouds = sample_clouds(simulator.meshes(), TASK.layout, TASK.cloud_seed)
    yield simulator, RayCaster(simulator.meshes(), TASK.layout), clouds
    simulator.close()


@pytest.fixture
def look(world):
    """``look()``: a frame of the present instant."""
    simulator, caster, _ = world

    def frame():
        poses = matrix_from_pose7(torch.as_tensor(simulator.poses())).numpy()
        view = caster.view(VIEW, poses)
        return Frame(None, view.depth, VIEW, view.segmentation.astype(int), simulator.joints()[0])

    simulator.reset(300_000)
    return frame


def make(world, completer=None, segmenter=None):
    segmenter = segmenter or IdSegmenter(TASK.layout)
    return SceneObserver(
        "PickCube", TASK.layout, TASK.robot.cloud(), segmenter, completer or HullCompleter(), clouds=world[2]
    )


def centre(scene):
    return batch_state([scene]).entity("cube").mean(1)[0].numpy()


def test_a_view_becomes_a_scene_that_both_twins_take(world, look, env):
    simulator = world[0]
    seen = make(world)(look(), simulator.goal())
    scene = seen.scene.validate("PickCube", TASK.layout, 3)
    np.testing.assert_allclose(scene.poses[0, :3], simulator.poses()[:3], atol=1e-5)
    np.testing.assert_allclose(scene.joints[0], simulator.joints()[0])
    np.testing.assert_array_equal(scene.clouds[:900], world[2][:900])
    points = batch_state([scene]).entity("cube")[0]
    truth = simulator.poses()[3, :3]
    assert np.linalg.norm(points.mean(0).numpy() - truth) < 0.015 and points[:, 2].min() >= 0
    assert len(seen.partials["cube"]) >= 32 and sum(seen.seconds.values()) < 5
    assert list(seen.seconds) == ["robot", "segment", "clean", "complete"]
    observation, _ = env.reset(options={"scene": scene})
    np.testing.assert_allclose(observation["points"], batch_state([scene]).points()[0], atol=1e-6)


def test_the_cube_is_followed_through_a_grasp(world, look):
    simulator, observer, errors, moved = world[0], make(world), [], []
    expert = TASK.expert(np.random.default_rng(0))
    first = observer(look(), simulator.goal()).scene
    offset = centre(first) - simulator.poses()[3, :3]
    for _ in range(60):
        action = expert.act(simulator.poses(), simulator.goal())
        simulator.step(action)
        carried = {"cube": "hand"} if simulator.outcome().grasped else None
        seen = observer(look(), simulator.goal(), action, carried)
        errors.append(np.linalg.norm(centre(seen.scene) - offset - simulator.poses()[3, :3]))
        moved.append(np.linalg.norm(seen.scene.poses[0, 3, :3] - seen.scene.poses[1, 3, :3]))
        np.testing.assert_array_equal(seen.scene.clouds, first.clouds)
    assert simulator.poses()[3, 2] > 0.05  # lifted
    assert np.quantile(errors, 0.9) < 0.006 and 0.003 < np.max(moved) < 0.02
    assert "track" in seen.seconds and "complete" not in seen.seconds


def test_a_hidden_cube_stays_where_it_was_or_goes_with_the_hand(world, look):
    simulator, hidden = world[0], set()
    segmenter = MaskSegmenter(lambda f: {n: f.segmentation == 3 for n in ["cube"] if n not in hidden})
    observer = make(world, segmenter=segmenter)
    first = observer(look(), simulator.goal()).scene
    hidden.add("cube")
    for carried in (None, {"cube": "hand"}):
        before = simulator.poses()[0, :3]
        for _ in range(4):
            simulator.step(np.array([0, 0, 0.5, 0, 0, 0, 1], np.float32))
            scene = observer(look(), simulator.goal(), carried=carried).scene
        rose = simulator.poses()[0, :3] - before
        assert rose[2] > 0.02
        expected = centre(first) + (0 if carried is None else rose)
        np.testing.assert_allclose(centre(scene), expected, atol=1e-3)


def test_a_new_episode_is_completed_anew(world, look):
    simulator, observer = world[0], make(world)
    first = observer(look(), simulator.goal()).scene
    simulator.reset(300_001)
    observer.reset()
    again = observer(look(), simulator.goal()).scene
    assert not np.array_equal(first.clouds[900:], again.clouds[900:])
    assert np.linalg.norm(centre(again) - simulator.poses()[3, :3]) < 0.015
    np.testing.assert_array_equal(again.poses[0], again.poses[1])


def test_expected_errors_are_passed_on_and_nothing_is_below_the_table(world, look):
    def sunk(partial, eye, points=2048):
        done = HullCompleter()(partial, eye, points)
        return Completion(done.points - np.float32([0, 0, 0.03]), 0.004)

    seen = make(world, sunk)(look(), world[0].goal())
    assert seen.errors == {"cube": 0.004}
    assert batch_state([seen.scene]).entity("cube")[..., 2].min() > -1e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: replace(f, joints=None), "the frame has no joints"),
        (
            lambda f: replace(f, segmentation=np.full_like(f.segmentation, -1)),
            r"'cube' is not in the first view \(found",
        ),
        (lambda f: replace(f, depth=np.zeros_like(f.depth)), "'cube' is hardly seen in the first view"),
    ],
)
def test_a_first_view_that_does_not_do_is_named(world, look, change, message):
    with pytest.raises(SceneError, match=message):
        make(world)(change(look()), world[0].goal())


def test_a_robot_without_a_link_is_named(world):
    layout = Layout.build([("arm", 10), ("cube", 10)], driven=("arm",))
    with pytest.raises(SceneError, match="no cloud of arm; it has hand, left_gripper, right_gripper"):
        SceneObserver("PickCube", layout, TASK.robot.cloud(), IdSegmenter(layout), HullCompleter())


@pytest.mark.parametrize("yaw", [-0.7, 0.0, 0.3])
def test_the_canonical_frame_of_a_box_is_its_own(yaw):
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    corners = np.array(np.meshgrid([-0.1, 0.1], [-0.03, 0.03], [0, 0.04])).reshape(3, -1).T
    pose = _upright_frame(corners @ turn.T + [0.5, 0.1, 0])
    np.testing.assert_allclose(pose[:3, 3], [0.5, 0.1, 0.02], atol=1e-9)
    np.testing.assert_allclose(pose[:3, :3], turn, atol=1e-6)


def test_without_a_robot_the_frame_tells_where_its_links_are(world, look):
    simulator, _, clouds = world
    layout, links = TASK.layout, simulator.poses()[:3]
    observer = SceneObserver("PickCube", layout, None, IdSegmenter(layout), HullCompleter(), clouds=clouds)
    seen = observer(replace(look(), links=links), simulator.goal())
    np.testing.assert_allclose(seen.scene.poses[0, :3, :3], links[:, :3], atol=1e-6)
    with pytest.raises(SceneError, match="the frame has no links; expected the poses .L, 7. of hand, left_gripper"):
        observer(look(), simulator.goal())
    with pytest.raises(SceneError, match="the frame has 2 links; expected"):
        observer(replace(look(), links=links[:2]), simulator.goal())
    with pytest.raises(SceneError, match="robot=None and clouds=None; expected one of them"):
        SceneObserver("PickCube", layout, None, IdSegmenter(layout), HullCompleter())
