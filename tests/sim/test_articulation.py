"""Articulated objects as entities of a ManiSkill simulator: MugCleanup's drawer and Coffee's lid."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from kitchen import CABINET_AT, DRAWER_AT, MUG_AT, pulled, put_in, scene_of
from scipy.spatial.transform import Rotation

from pwm_gym.errors import SceneError
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Scene, sample_clouds
from pwm_gym.scene.poses import compose
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.sim.coffee_machine import LID, LID_JOINT, MACHINE, OPEN_ANGLE, POD
from pwm_gym.sim.mugs import MUGS, get_mug
from pwm_gym.sim.shapes import Box
from pwm_gym.tasks import get_task

TASK, COFFEE = get_task("MugCleanup"), get_task("Coffee")
REST = np.array([0, 0, 0, 0, 0, 0, 1.0], np.float32)


def opening(simulator):
    """Position of the drawer's joint by the layout, which has to fit its pose in all else, too."""
    poses = matrix_from_pose7(torch.as_tensor(simulator.poses())).float()
    tree = JointTree(TASK.layout, [DRAWER_AT])
    position = tree.positions(poses)
    torch.testing.assert_close(tree.place(poses, position)[DRAWER_AT], poses[DRAWER_AT], atol=1e-5, rtol=0)
    return float(position[0])


def joint(simulator, name="cabinet"):
    """Position and velocity a step of an articulated object's joint, as the simulator says."""
    base = simulator.env.unwrapped
    articulation = base.scene.articulations[name]
    return float(articulation.qpos[0, 0]), float(articulation.qvel[0, 0]) / base.control_freq


@pytest.mark.parametrize("amount", [0.0, 0.07, LOW_CABINET.stroke])
def test_a_drawer_is_restored_from_its_pose(mug_simulator, amount):
    mug_simulator.reset(1)
    scene = pulled(scene_of(mug_simulator), amount)
    mug_simulator.reset(2)
    mug_simulator.restore(scene)
    np.testing.assert_allclose(mug_simulator.poses(), scene.poses[0], atol=1e-5)
    assert opening(mug_simulator) == pytest.approx(joint(mug_simulator)[0], abs=1e-5)
    assert opening(mug_simulator) == pytest.approx(amount, abs=1e-5)
    mug_simulator.restore(scene_of(mug_simulator), rebuild=False)
    assert joint(mug_simulator) == pytest.approx((amount, 0.0), abs=1e-5)


def test_a_drawer_goes_on_as_fast_as_its_poses_tell(mug_simulator):
    mug_simulator.reset(1)
    mug_simulator.restore(pulled(scene_of(mug_simulator), 0.05, speed=0.004))
    assert joint(mug_simulator) == pytest.approx((0.05, 0.004), abs=1e-5)
    mug_simulator.step(REST)
    assert 1e-4 < opening(mug_simulator) - 0.05 < 0.004  # damping and friction brake it


def test_a_drawer_stays_within_its_limits(mug_simulator):
    mug_simulator.reset(1)
    scene = scene_of(mug_simulator)
    for start, speed in ((0.01, -0.02), (LOW_CABINET.stroke - 0.01, 0.02)):
        mug_simulator.restore(pulled(scene, start, speed))
        found = [(mug_simulator.step(REST), opening(mug_simulator))[1] for _ in range(5)]
        assert min(found) > -1e-3 and max(found) < LOW_CABINET.stroke + 1e-3


@pytest.mark.parametrize("amount", [-0.02, LOW_CABINET.stroke + 0.02])
def test_a_scene_with_a_joint_beyond_its_limits_is_refused(mug_simulator, amount):
    mug_simulator.reset(1)
    with pytest.raises(SceneError, match=r"joint of 'drawer' is at .*; expected 0\.0000 to 0\.1600"):
        mug_simulator.restore(pulled(scene_of(mug_simulator), amount))


def test_an_open_drawer_with_a_mug_in_it_stays_as_it_is(mug_simulator):
    mug_simulator.reset(1)
    mug_simulator.restore(put_in(pulled(scene_of(mug_simulator), 0.1)))
    before = mug_simulator.poses()
    for _ in range(30):
        mug_simulator.step(REST)
    moved = np.linalg.norm(mug_simulator.poses()[:, :3] - before[:, :3], axis=-1)
    assert moved[CABINET_AT] == 0 and moved[DRAWER_AT] < 1e-3 and moved[MUG_AT] < 2e-3


def test_scenes_and_episodes_repeat(mug_simulator, random_actions):
    actions = 0.5 * random_actions(0, 12, TASK.action_size)

    def follow():
        return np.array([(mug_simulator.step(a), mug_simulator.poses())[1] for a in actions])

    mug_simulator.reset(5)
    start, mug, truth = mug_simulator.poses(), mug_simulator.assets(), follow()
    scene = put_in(pulled(scene_of(mug_simulator), 0.12))
    mug_simulator.restore(scene)
    restored = follow()
    mug_simulator.reset(6)
    assert np.abs(mug_simulator.poses()[CABINET_AT:, :3] - start[CABINET_AT:, :3]).max(-1).min() > 1e-3
    mug_simulator.reset(5)
    assert mug_simulator.assets() == mug
    np.testing.assert_array_equal(mug_simulator.poses(), start)
    np.testing.assert_array_equal(follow(), truth)
    mug_simulator.restore(scene)
    np.testing.assert_array_equal(follow(), restored)


def test_a_scene_brings_its_own_mug(mug_simulator):
    mug_simulator.reset(1)
    scene = scene_of(mug_simulator)
    other = next(name for name in MUGS if name != scene.assets[MUG_AT])
    mug_simulator.restore(replace(scene, assets=(*scene.assets[:-1], other)), rebuild=False)
    assert mug_simulator.assets()[MUG_AT] == other
    size = np.ptp(mug_simulator.meshes()["mug"].bounds, axis=0)
    assert size[2] == pytest.approx(get_mug(other).height, abs=1e-5)


@pytest.mark.parametrize("name", ["cabinet", "drawer"])
def test_articulated_links_cannot_be_placed(mug_simulator, name):
    with pytest.raises(SceneError, match=f"'{name}' is a link of an articulated object; only free bodies"):
        mug_simulator.place(name, mug_simulator.poses()[0])


def depth(points, shape):
    """How deep (n,) points (n, 3) are in a shape; negative outside."""
    local = points - np.asarray(shape.centre)
    if isinstance(shape, Box):
        local = Rotation.from_quat(shape.quaternion, scalar_first=True).inv().apply(local)
        return (0.5 * np.array(shape.size) - np.abs(local)).min(-1)
    beside = shape.radius - np.linalg.norm(local[:, :2], axis=-1)
    return np.minimum(beside, 0.5 * shape.height - np.abs(local[:, 2]))


def check_surfaces(simulator, layout, solids):
    clouds = sample_clouds(simulator.meshes(), layout, 0)
    for name, shapes in solids.items():
        deepest = np.max([depth(clouds[layout[name].slice], shape) for shape in shapes], 0)
        assert np.abs(deepest).max() < 2e-4, name
        assert simulator.meshes()[name].is_volume


def test_clouds_lie_on_outer_surfaces(mug_simulator, coffee_simulator):
    """Where boxes overlap, none of their hidden faces is sampled."""
    mug_simulator.reset(3)
    mug = get_mug(mug_simulator.assets()[MUG_AT])
    check_surfaces(
        mug_simulator, TASK.layout, {"cabinet": LOW_CABINET.body, "drawer": LOW_CABINET.drawer, "mug": mug.shapes()}
    )
    check_surfaces(coffee_simulator, COFFEE.layout, {"machine": MACHINE, "lid": LID, "pod": POD})


@pytest.mark.parametrize("degrees", [0.0, 40.0, 100.0])
def test_a_lid_is_restored_from_its_pose(coffee_simulator, degrees):
    coffee_simulator.reset(1)
    poses, lid = np.stack([coffee_simulator.poses()] * 3), COFFEE.layout.index("lid")
    assert joint(coffee_simulator, "machine") == pytest.approx((OPEN_ANGLE, 0.0), abs=1e-5)
    angle = np.radians(degrees)
    for k in range(3):
        turn = Rotation.from_rotvec((angle - 0.03 * k * (degrees == 40.0)) * np.array(LID_JOINT.axis))
        opened = np.r_[LID_JOINT.origin[:3], turn.as_quat(scalar_first=True)]
        poses[k, lid] = compose(poses[k, COFFEE.layout.index("machine")], opened)
    clouds = np.zeros((COFFEE.layout.points, 3), np.float32)
    scene = Scene("Coffee", COFFEE.layout, clouds, poses, coffee_simulator.goal(), coffee_simulator.joints())
    coffee_simulator.restore(scene)
    assert joint(coffee_simulator, "machine") == pytest.approx((angle, 0.03 * (degrees == 40.0)), abs=1e-5)
    np.testing.assert_allclose(coffee_simulator.poses(), poses[0], atol=1e-5)
    frames = matrix_from_pose7(torch.as_tensor(coffee_simulator.poses())).float()
    tree = JointTree(COFFEE.layout, [lid])
    torch.testing.assert_close(tree.place(frames, tree.positions(frames))[lid], frames[lid], atol=1e-5, rtol=0)
    assert float(tree.positions(frames)[0]) == pytest.approx(angle, abs=1e-5)
