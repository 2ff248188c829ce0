import numpy as np
import pytest
import torch
import trimesh

from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.robots.cloud import RobotCloud
from pwm_gym.robots.panda import PANDA
from pwm_gym.scene import Scene
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.tasks import get_task

BODIES, ARM = PANDA.links, PANDA.control.arms[0].chain

TASK = get_task("PickCube")
URDF = """<?xml version="1.0" ?>
<robot name="crane">
  <link name="rail"/>
  <link name="tower">
    <visual><geometry><sphere radius="0.5"/></geometry></visual>
    <collision>
      <origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/>
      <geometry><box size="0.4 0.2 1.0"/></geometry>
    </collision>
  </link>
  <link name="arm">
    <collision>
      <origin xyz="0.3 0 0" rpy="0 1.5707963267948966 0"/>
      <geometry><cylinder radius="0.05" length="0.6"/></geometry>
    </collision>
    <collision><origin xyz="0.6 0 0"/><geometry><sphere radius="0.1"/></geometry></collision>
  </link>
  <link name="hook">
    <collision><geometry><mesh filename="parts/hook.stl" scale="0.001 0.001 0.002"/></geometry></collision>
  </link>
  <link name="weight">
    <collision><geometry><mesh filename="package://crane/parts/hook.stl"/></geometry></collision>
  </link>
  <joint name="turn" type="continuous">
    <parent link="tower"/><child link="arm"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="rail"/><child link="tower"/><limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="drop" type="prismatic">
    <parent link="arm"/><child link="hook"/><origin xyz="0.6 0 0" rpy="3.141592653589793 0 0"/><axis xyz="0 0 2"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="balance" type="prismatic">
    <parent link="tower"/><child link="weight"/><axis xyz="0 1 0"/>
    <limit lower="-9" upper="9" effort="1" velocity="1"/><mimic joint="drop" multiplier="-2" offset="0.25"/>
  </joint>
</robot>
"""


@pytest.fixture(scope="module")
def panda():
    return RobotCloud.from_urdf(panda_urdf(), BODIES.values(), names=BODIES)


@pytest.fixture
def crane(tmp_path):
    """Path of a small URDF whose mesh lies in the package folder ``crane``."""
    folder = tmp_path / "crane"
    (folder / "urdf" / "parts").mkdir(parents=True)
    (folder / "parts").mkdir()
    trimesh.creation.box((100, 100, 100)).export(folder / "urdf" / "parts" / "hook.stl")
    trimesh.creation.box((0.3, 0.3, 0.3)).export(folder / "parts" / "hook.stl")
    path = folder / "urdf" / "crane.urdf"
    path.write_text(URDF)
    return path


def panda_urdf():
    return pytest.importorskip("mani_skill").PACKAGE_ASSET_DIR / "robots/panda/panda_v2.urdf"


def configurations(count, seed=0):
    """Joint positions (count, 9) within the Panda's limits; both fingers open, each by itself."""
    generator = np.random.default_rng(seed)
    arm = generator.uniform(ARM.lower, ARM.upper, (count, 7))
    return np.concatenate([arm, generator.uniform(0, 0.04, (count, 2))], 1).astype(np.float32)


def simulated(simulator, joints):
    """The simulator's link poses (count, 3, 4, 4) in its base's frame, with the joints (count, 9) set."""
    simulator.reset(0)
    poses, found = simulator.poses(), []
    for values in joints:
        state = np.stack([values, np.zeros(9, np.float32)])
        clouds = np.zeros((TASK.layout.points, 3), np.float32)
        simulator.restore(
            Scene("PickCube", TASK.layout, clouds, np.stack([poses] * 3), simulator.goal(), state), rebuild=False
        )
        found.append(simulator.poses()[: len(BODIES)])
    return matrix_from_pose7(torch.as_tensor(np.array(found)))


def test_agrees_with_the_simulators_links(panda, simulator):
    joints = configurations(50)
    expected, poses = simulated(simulator, joints), panda.poses(torch.as_tensor(joints).double())
    assert panda.layout.names == TASK.layout.names[:3] and all(e.driven for e in panda.layout)
    assert (expected[..., :3, 3] - poses[..., :3, 3]).norm(dim=-1).max() < 1e-4
    # chord of the rotations' difference, which is exact where the angle's arc cosine is not
    chord = (expected[..., :3, :3] - poses[..., :3, :3]).flatten(-2).norm(dim=-1) / 2**0.5
    assert torch.rad2deg(chord).max() < 0.01
    assert expected[:, 1:, :3, 3].std(0).min() > 0.05  # the arm does move


def test_samples_what_the_simulator_collides_with(panda, simulator):
    for name, mesh in simulator.meshes().items():
        if name in BODIES:
            np.testing.assert_allclose(panda.meshes[name].bounds, mesh.bounds, atol=1e-3)
    visual = RobotCloud.from_urdf(panda_urdf(), BODIES.values(), names=BODIES, geometry="visual")
    for name in BODIES:
        assert len(visual.meshes[name].faces) > len(panda.meshes[name].faces)
        np.testing.assert_allclose(visual.meshes[name].bounds, panda.meshes[name].bounds, atol=1e-3)


def test_the_second_finger_follows_the_first_where_it_has_no_value(panda):
    joints = torch.as_tensor(configurations(4))
    eight, nine = panda.poses(joints[:, :8]), panda.poses(joints)
    torch.testing.assert_close(eight[:, :2], nine[:, :2])
    assert (eight[:, 2] - nine[:, 2]).abs().max() > 1e-3
    joints[:, 8] = joints[:, 7]
    torch.testing.assert_close(eight, panda.poses(joints))


def test_joints_in_another_order(panda):
    names = [*panda.joints[7:], *panda.joints[:7]]
    other = RobotCloud.from_urdf(panda_urdf(), ["panda_leftfinger"], names)
    joints = torch.as_tensor(configurations(3))
    torch.testing.assert_close(other.poses(joints.roll(2, -1))[:, 0], panda.poses(joints)[:, 1])
    assert other.layout.names == ("panda_leftfinger",) and other.joints == tuple(names)


def test_batches_keep_dtype_and_agree_with_single_vectors(panda):
    joints = torch.as_tensor(configurations(6)).view(2, 3, 9)
    poses, points = panda.poses(joints), panda.points(joints)
    assert poses.shape == (2, 3, 3, 4, 4) and points.shape == (2, 3, 900, 3)
    assert poses.dtype == points.dtype == torch.float32
    assert panda.poses(joints.numpy()[0, 0].astype(np.float64)).dtype == torch.float64
    torch.testing.assert_close(panda.points(joints[1, 2].double()), points[1, 2].double(), atol=1e-6, rtol=0)
    assert panda.points(joints[:0]).shape == (0, 3, 900, 3)
    hand = trimesh.Trimesh(panda.meshes["hand"].vertices, panda.meshes["hand"].faces)
    hand.apply_transform(poses[1, 2, 0].numpy())
    _, gap, _ = trimesh.proximity.closest_point_naive(hand, points[1, 2, panda.layout["hand"].slice][:40].numpy())
    assert gap.max() < 1e-5


def test_gradients_reach_the_joints(panda):
    joints = torch.as_tensor(configurations(2)).double()[:, :8]
    assert torch.autograd.gradcheck(panda.poses, (joints.requires_grad_(),))
    (slope,) = torch.autograd.grad(panda.points(joints)[..., 2].mean(), joints)
    assert (slope[:, 1:7].abs() > 1e-6).all()


def test_shapes_stand_where_their_origins_say(crane):
    robot = RobotCloud.from_urdf(crane, ["tower", "arm", "hook", "weight"], points=64)
    assert robot.joints == ("turn", "slide", "drop", "balance") and robot.layout.points == 4 * 64
    bounds = {name: mesh.bounds for name, mesh in robot.meshes.items()}
    np.testing.assert_allclose(bounds["tower"], [[-0.1, -0.2, 0], [0.1, 0.2, 1]], atol=1e-6)
    np.testing.assert_allclose(bounds["arm"], [[0, -0.1, -0.1], [0.7, 0.1, 0.1]], atol=1e-3)
    np.testing.assert_allclose(bounds["hook"], [[-0.05, -0.05, -0.1], [0.05, 0.05, 0.1]], atol=1e-6)
    np.testing.assert_allclose(bounds["weight"], [[-0.15] * 3, [0.15] * 3], atol=1e-6)
    seen = RobotCloud.from_urdf(crane, ["tower"], geometry="visual", points={"tower": 32})
    np.testing.assert_allclose(np.linalg.norm(seen.clouds, axis=1), 0.5, atol=5e-3)


def test_a_branched_chain_moves_as_its_description_says(crane):
    robot = RobotCloud.from_urdf(crane, ["hook", "weight"], names={"load": "hook"}, points=8)
    assert robot.layout.names == ("load", "weight")
    hook, weight = robot.poses(torch.tensor([np.pi / 2, 0.5, 0.2], dtype=torch.float64))
    np.testing.assert_allclose(hook[:3, 3], [0.5, 0.6, 0.8], atol=1e-6)  # "slide" has no axis: the standard's is x
    np.testing.assert_allclose(hook[:3, :3], [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-6)
    np.testing.assert_allclose(weight[:3, 3], [0.5, 0.25 - 2 * 0.2, 0], atol=1e-6)
    own = robot.poses(torch.tensor([0.0, 0.5, 0.2, 0.3]))
    np.testing.assert_allclose(own[1, :3, 3], [0.5, 0.3, 0], atol=1e-6)


def test_only_the_joints_that_move_a_link_need_values(crane):
    robot = RobotCloud.from_urdf(crane, ["tower"], ["slide"], points=8)
    np.testing.assert_allclose(robot.poses(torch.tensor([0.3]))[0, :3, 3], [0.3, 0, 0])
    follower = RobotCloud.from_urdf(crane, ["weight"], ["slide", "drop"], points=8)
    np.testing.assert_allclose(follower.poses(torch.tensor([0, 0.5]))[0, :3, 3], [0, -0.75, 0], atol=1e-6)
    with pytest.raises(PwmGymError, match=r"no value for joint 'turn', which moves 'hook'; got slide, drop"):
        RobotCloud.from_urdf(crane, ["hook"], ["slide", "drop"], points=8)


def test_a_finer_cloud_begins_with_the_coarser_one(crane):
    first = RobotCloud.from_urdf(crane, ["tower"], points=64).clouds
    again = RobotCloud.from_urdf(crane, ["tower"], points=64).clouds
    np.testing.assert_array_equal(first, again)
    gaps = np.linalg.norm(first[:8, None] - first[None, :8], axis=-1) + np.eye(8)
    assert gaps.min() > 0.2  # of a tower 1 m high


def test_unknown_names_are_told(crane):
    with pytest.raises(UnknownNameError, match=r"unknown link 'hok'; known: .*Did you mean 'hook'"):
        RobotCloud.from_urdf(crane, ["hok"])
    with pytest.raises(UnknownNameError, match=r"unknown joint 'spin'; known: balance, drop, slide, turn"):
        RobotCloud.from_urdf(crane, ["hook"], ["spin"])
    with pytest.raises(UnknownNameError, match=r"unknown link 'rail'; known: hook"):
        RobotCloud.from_urdf(crane, ["hook"], names={"load": "rail"})
    with pytest.raises(UnknownNameError, match="unknown geometry 'visuals'"):
        RobotCloud.from_urdf(crane, ["hook"], geometry="visuals")
    with pytest.raises(UnknownNameError, match="unknown entity 'hook'; known: load"):
        RobotCloud.from_urdf(crane, ["hook"], points={"load": 8})


def test_a_wrong_number_of_joints_is_told(panda):
    with pytest.raises(PwmGymError, match=r"got 7 joints; expected 9 or 8: panda_joint1, "):
        panda.poses(torch.zeros(2, 7))
    with pytest.raises(PwmGymError, match="got 0 joints"):
        panda.points(torch.tensor(1.0))


def test_bad_descriptions_are_told(crane):
    with pytest.raises(FileNotFoundError, match=r"none\.urdf does not exist"):
        RobotCloud.from_urdf(crane.with_name("none.urdf"), ["hook"])
    with pytest.raises(PwmGymError, match="link 'rail' has no collision shape"):
        RobotCloud.from_urdf(crane, ["rail"])
    with pytest.raises(PwmGymError, match="no links"):
        RobotCloud.from_urdf(crane, [])
    bad = {
        "<robot": "is not a URDF",
        "<robot/>": "with movable joints",
        URDF.replace('radius="0.05"', 'radius="x"'): "<cylinder> has radius='x'; expected numbers",
        URDF.replace("<sphere", "<capsule"): "unknown shape 'capsule'",
        URDF.replace('"continuous"', '"planar"'): "unknown type of joint 'turn' 'planar'",
        URDF.replace('<mimic joint="drop"', '<mimic joint="dorp"'): "unknown joint 'dorp'.*Did you mean 'drop'",
    }
    for text, message in bad.items():
        crane.write_text(text)
        with pytest.raises(PwmGymError, match=message):
            RobotCloud.from_urdf(crane, ["arm"])
    crane.write_text(URDF.replace("parts/hook.stl", "parts/claw.stl"))
    with pytest.raises(FileNotFoundError, match=r"mesh 'parts/claw\.stl' is not found from"):
        RobotCloud.from_urdf(crane, ["hook"])
