"""A cabinet with its drawer, and what lies in it, as a camera shows them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from kitchen import CABINET_AT, DRAWER_AT, MUG_AT, TASK, pulled, put_in, scene_of

from pwm_gym.completion import HullCompleter
from pwm_gym.errors import SceneError
from pwm_gym.perception import SceneObserver
from pwm_gym.perception.build import build_observer
from pwm_gym.perception.furniture import Furniture, furniture_names
from pwm_gym.perception.segmenters import IdSegmenter
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Joint, Layout, sample_clouds
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.tasks import get_task

TREE = JointTree(TASK.layout, [DRAWER_AT])


@pytest.fixture(scope="module")
def world(mug_simulator):
    """MugCleanup's canonical clouds, a scene of it, and an observer that sees scenes by a depth camera."""
    mug_simulator.reset(1)
    clouds = sample_clouds(mug_simulator.meshes(), TASK.layout, 0).astype(np.float32)
    scene = scene_of(mug_simulator, clouds)
    return scene, build_observer(TASK, TASK.layout, mug_simulator.meshes(), clouds, HullCompleter())


def opening(scene):
    """Position of the drawer's joint by its pose and the cabinet's."""
    return float(TREE.positions(matrix_from_pose7(torch.as_tensor(scene.poses[0])).float())[0])


def off(scene, truth, name):
    """Distance between the places of an entity's points in a scene and in truth, mean, metres."""
    found = []
    for each in (scene, truth):
        pose = matrix_from_pose7(torch.as_tensor(each.poses[0, TASK.layout.index(name)])).double().numpy()
        found.append(truth.clouds[TASK.layout[name].slice] @ pose[:3, :3].T + pose[:3, 3])
    return np.linalg.norm(found[0] - found[1], axis=-1).mean()


@pytest.mark.parametrize("amount", [0.0, 0.06, LOW_CABINET.stroke])
def test_the_first_view_tells_where_the_cabinet_stands_and_how_far_it_is_open(world, amount):
    scene, observer = world
    truth = pulled(scene, amount)
    observer.reset(0)
    seen = observer(truth)
    assert opening(seen.scene) == pytest.approx(amount, abs=0.002)
    assert off(seen.scene, truth, "cabinet") < 0.003 and off(seen.scene, truth, "drawer") < 0.003
    for name in ("cabinet", "drawer"):
        part = TASK.layout[name].slice
        np.testing.assert_array_equal(seen.scene.clouds[part], scene.clouds[part])
    assert set(seen.errors) == {"mug"}


def test_a_drawer_is_followed_along_its_joint_and_keeps_what_lies_in_it(world):
    scene, observer = world
    observer.reset(0)
    amounts = [0.14, 0.12, 0.09, 0.06, 0.03, 0.0]
    mug_seen, offsets = [], []
    for amount in amounts:
        truth = put_in(pulled(scene, amount))
        seen = observer(truth)
        assert opening(seen.scene) == pytest.approx(amount, abs=0.003)
        assert off(seen.scene, truth, "drawer") < 0.004
        mug_seen.append("mug" in seen.partials)
        mug, drawer = (seen.scene.poses[0, k, :3] for k in (MUG_AT, DRAWER_AT))
        offsets.append(mug - drawer)
    assert mug_seen[0] and not mug_seen[-1]  # the shut drawer hides it
    assert np.linalg.norm(np.ptp(offsets, axis=0)) < 0.008  # and it went with the drawer


def test_what_no_view_has_shown_stands_in_the_drawer_until_one_does(world):
    scene, observer = world
    observer.reset(0)
    shut = put_in(pulled(scene, 0.0))
    first = observer(shut)
    assert "mug" not in first.partials and "mug" not in first.errors
    assert np.linalg.norm((first.scene.poses[0, MUG_AT] - shut.poses[0, MUG_AT])[:2]) < 0.04
    for amount in (0.03, 0.06, 0.09, 0.12, 0.15):
        truth = put_in(pulled(scene, amount))
        seen = observer(truth)
    assert "mug" in seen.errors
    assert np.linalg.norm((seen.scene.poses[0, MUG_AT] - truth.poses[0, MUG_AT])[:2]) < 0.02
    np.testing.assert_allclose(first.scene.poses[0, CABINET_AT], seen.scene.poses[0, CABINET_AT])


def test_bodies_with_joints_are_named_and_need_their_clouds():
    assert furniture_names(TASK.layout) == ("cabinet", "drawer")
    assert furniture_names(get_task("CoffeePreparation").layout) == ("machine", "lid", "cabinet", "drawer")
    assert furniture_names(get_task("PickCube").layout) == ()
    with pytest.raises(SceneError, match="cabinet, drawer hang on joints; expected the layout's canonical clouds"):
        SceneObserver(TASK.name, TASK.layout, TASK.robot.cloud(), IdSegmenter(TASK.layout), HullCompleter())


def test_joints_that_no_view_could_tell_are_refused():
    hung = Joint("revolute", None, axis=(1.0, 0.0, 0.0), lower=0.0, upper=1.0)
    layout = Layout.build([("flap", 20)], [], {"flap": hung})
    with pytest.raises(SceneError, match="'flap' hangs on None; perception expects a part"):
        Furniture(layout, {"flap": np.random.default_rng(0).normal(size=(20, 3))})


def test_an_object_that_nothing_may_hide_has_to_be_seen(world):
    scene, observer = world
    observer.reset(0)
    poses = scene.poses.copy()
    poses[:, DRAWER_AT, 2] -= 5.0
    with pytest.raises(SceneError, match="'drawer' is not in the first view"):
        observer(replace(scene, poses=poses))
