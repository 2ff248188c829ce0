"""Any MuJoCo model as a simulator."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh
from mujoco_models import SPHERE, make, run, scene_of, xml
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError, SceneError, UnknownNameError
from pwm_gym.robots import Channel, Control
from pwm_gym.scene import Layout
from pwm_gym.sim import PlacesBodies, Simulator
from pwm_gym.sim.mujoco import MujocoSimulator, RoboticsWorld, XmlWorld

BOX = '<body name="box" pos="0 0 0.03"><freejoint/><geom type="box" size="0.03 0.04 0.03" mass="0.1"/></body>'
CABINET = """
    <body name="cabinet" pos="0.3 0 0.1">
      <geom type="box" size="0.02 0.1 0.1" contype="0" conaffinity="0" mass="1"/>
      <geom type="box" size="0.02 0.1 0.1" mass="1"/>
      <body name="drawer" pos="-0.1 0 -0.05">
        <joint name="slide" type="slide" axis="1 0 0" damping="2" range="-0.2 0.1"/>
        <geom type="box" size="0.03 0.05 0.02" mass="0.2"/>
        <body name="lid" pos="0 0 0.03" quat="0.9659258 0 0 0.2588190">
          <joint name="hinge" type="hinge" axis="0 0.6 0.8" pos="0.03 0 0" damping="0.05" range="-2 2"/>
          <geom type="box" size="0.03 0.04 0.005" pos="0 0 0.01" mass="0.05" contype="0" conaffinity="0"/>
          <geom type="box" size="0.03 0.04 0.005" pos="0 0 0.01" mass="0.05"/>
        </body>
      </body>
    </body>"""


@pytest.fixture(scope="module")
def pushing():
    return make(xml(BOX), "pusher", "box")


def test_it_is_a_simulator_that_places_bodies(pushing):
    assert isinstance(pushing, Simulator) and isinstance(pushing, PlacesBodies)
    pushing.reset(0)
    pushing.place("box", np.array([0.4, 0.1, 0.2, 0.0, 1.0, 0.0, 0.0]))
    np.testing.assert_allclose(pushing.poses()[1], [0.4, 0.1, 0.2, 0, 1, 0, 0], atol=1e-12)
    pushing.step(np.zeros(1))
    assert pushing.poses()[1, 2] < 0.2  # it falls
    with pytest.raises(SceneError, match="'pusher' is no free body"):
        pushing.place("pusher", pushing.poses()[0])


@pytest.mark.parametrize(
    ("geom", "extents"),
    [
        ('type="box" size="0.01 0.02 0.03"', [0.02, 0.04, 0.06]),
        ('type="sphere" size="0.02"', [0.04, 0.04, 0.04]),
        ('type="cylinder" size="0.01 0.03"', [0.02, 0.02, 0.06]),
        ('type="capsule" size="0.01 0.03"', [0.02, 0.02, 0.08]),
        ('type="ellipsoid" size="0.01 0.02 0.03"', [0.02, 0.04, 0.06]),
        ('type="mesh" mesh="wedge"', [0.05, 0.03, 0.02]),
    ],
)
def test_canonical_surfaces_have_the_geoms_extents(geom, extents):
    """Shifted and turned a quarter about z: x and y change places."""
    wedge = '<asset><mesh name="wedge" vertex="0 0 0 0.05 0 0 0 0.03 0 0 0 0.02"/></asset>'
    place = 'pos="0.1 0.2 0.3" quat="0.70710678 0 0 0.70710678"'
    fixed = f'<body name="fixed" {place}><geom {geom} mass="0.1"/></body>'
    thing = f'<body name="thing" pos="0 0 1"><freejoint/>{fixed}</body>'
    mesh = make(xml(thing, wedge), "thing").meshes()["thing"]
    np.testing.assert_allclose(mesh.extents, np.array(extents)[[1, 0, 2]], rtol=0.01)
    assert mesh.is_watertight
    if "mesh" not in geom:
        np.testing.assert_allclose(mesh.bounds.mean(0), [0.1, 0.2, 0.3], atol=1e-6)


def test_a_stored_mesh_stands_where_its_vertices_were():
    """MuJoCo moves a mesh to its centre of mass and turns it to its axes of inertia."""
    wedge = '<asset><mesh name="wedge" vertex="0 0 0 0.05 0 0 0 0.03 0 0 0 0.02"/></asset>'
    thing = '<body name="thing"><freejoint/><geom type="mesh" mesh="wedge" mass="0.1"/></body>'
    mesh = make(xml(thing, wedge), "thing").meshes()["thing"]
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 0], [0.05, 0.03, 0.02]], atol=1e-6)


def test_only_what_collides_is_a_surface_unless_the_visual_one_is_asked_for():
    geoms = '<geom type="sphere" size="0.05" contype="0" conaffinity="0"/><geom type="sphere" size="0.02"/>'
    text = xml(f'<body name="ball" pos="0 0 1"><freejoint/>{geoms}</body>')
    assert make(text, "ball").meshes()["ball"].extents == pytest.approx([0.04] * 3, rel=0.01)
    assert make(text, "ball", visual=["ball"]).meshes()["ball"].extents == pytest.approx([0.10] * 3, rel=0.01)


def test_the_same_seed_and_a_fresh_simulator_give_the_same_future_bit_for_bit():
    def start(model, data, rng):
        data.qpos[1:3] = rng.uniform(-0.05, 0.05, 2)

    actions = np.random.default_rng(0).uniform(-1, 1, (20, 1))
    first, second = (make(xml(BOX), "pusher", "box", start=start) for _ in range(2))
    first.reset(3)
    wanted = run(first, actions)
    first.reset(4)
    assert np.abs(first.poses() - wanted[0]).max() > 1e-3
    for simulator in (first, second):
        simulator.reset(3)
        np.testing.assert_array_equal(run(simulator, actions), wanted)


def test_a_restored_scene_has_the_future_of_the_episode(pushing):
    rng = np.random.default_rng(1)
    pushing.reset(0)
    before = run(pushing, np.full((60, 1), 0.54))  # to the box, and a while there
    assert before[-1, 1, 0] > before[0, 1, 0] + 0.01
    scene, actions = scene_of(pushing, before[-3:][::-1]), rng.uniform(0.5, 0.8, (10, 1))
    wanted = run(pushing, actions)
    assert np.abs(wanted[-1, 1] - wanted[0, 1]).max() > 0.01
    pushing.restore(scene)
    again = run(pushing, actions)
    np.testing.assert_allclose(again, wanted, atol=1e-4)
    pushing.restore(scene)
    np.testing.assert_array_equal(run(pushing, actions), again)


def test_a_restored_body_flies_on(pushing):
    pushing.reset(0)
    pose = np.array([0.4, 0.1, 0.5, 1.0, 0.0, 0.0, 0.0])
    turn = Rotation.from_rotvec([0.0, 0.1, 0.2])
    pose[3:] = turn.as_quat(scalar_first=True)
    before = np.array([0.38, 0.1, 0.5, 1.0, 0.0, 0.0, 0.0])
    pusher = pushing.poses()[0]
    pushing.restore(scene_of(pushing, [[pusher, p] for p in (pose, before, before)]))
    pushing.step(np.zeros(1))
    after = pushing.poses()[1]
    assert after[0] == pytest.approx(0.42, abs=1e-3)
    turned = Rotation.from_quat(after[3:], scalar_first=True) * turn.inv()
    np.testing.assert_allclose(turned.as_rotvec(), [0.0, 0.1, 0.2], atol=0.01)


def test_articulated_bodies_are_restored_by_their_poses():
    names = ("pusher", "cabinet", "drawer", "lid")
    simulator, other = (make(xml(CABINET), *names) for _ in range(2))
    simulator.reset(0)
    simulator.data.qpos[1:] = [-0.12, 0.7]
    simulator.data.qvel[1:] = [0.3, -1.0]
    poses = run(simulator, np.zeros((4, 1)))
    assert np.abs(poses[-1] - poses[0])[2:].max() > 5e-3
    other.restore(scene_of(simulator, poses[-3:][::-1]))
    np.testing.assert_allclose(other.poses(), poses[-1], atol=1e-7)
    np.testing.assert_allclose(other.data.qpos, simulator.data.qpos, atol=1e-7)
    np.testing.assert_allclose(other.data.qvel[1:], simulator.data.qvel[1:], rtol=0.25, atol=0.02)


CHEST = """
    <body name="chest" pos="0 0.3 0.5">
      <freejoint/>
      <geom type="box" size="0.05 0.05 0.05" mass="0.5"/>
      <body name="lid" pos="-0.05 0 0.06">
        <joint name="lid" type="hinge" axis="0 1 0" damping="0.002"/>
        <geom type="box" size="0.05 0.05 0.005" pos="0.05 0 0" mass="0.05"/>
      </body>
    </body>"""


def test_what_hangs_on_a_free_body_is_restored_where_that_body_is():
    """The chest flies and turns, and its lid swings."""
    simulator, other = (make(xml(CHEST), "pusher", "chest", "lid") for _ in range(2))
    simulator.reset(0)
    simulator.data.qpos[1:4] = [0.4, 0.5, 0.8]
    simulator.data.qpos[4:8] = Rotation.from_rotvec([0.0, 0.3, 0.8]).as_quat(scalar_first=True)
    simulator.data.qpos[8] = -0.8
    simulator.data.qvel[1:] = [0.3, 0.1, 0.5, 0.0, 0.2, 1.0, -1.0]
    poses = run(simulator, np.zeros((4, 1)))
    assert np.abs(poses[-1, 1:] - poses[-2, 1:]).max() > 0.01
    other.restore(scene_of(simulator, poses[-3:][::-1]))
    np.testing.assert_allclose(other.data.qpos, simulator.data.qpos, atol=1e-6)
    np.testing.assert_allclose(other.poses(), poses[-1], atol=1e-6)
    assert other.data.qvel[7] == pytest.approx(simulator.data.qvel[7], abs=0.05)


def test_an_articulated_body_beyond_its_limits_or_off_its_joint_is_refused():
    names = ("pusher", "drawer")
    simulator = make(xml(CABINET), *names)
    simulator.reset(0)
    far, off = (simulator.poses() for _ in range(2))
    far[1, 0] += 0.3
    off[1, 2] += 0.1
    with pytest.raises(SceneError, match="joint 'slide' is at 0.3000; expected -0.2000 to 0.1000"):
        simulator.restore(scene_of(simulator, [far] * 3))
    with pytest.raises(SceneError, match="body 'drawer' cannot be where the scene has it.*100.0 mm"):
        simulator.restore(scene_of(simulator, [off] * 3))


def test_the_public_frame_is_that_of_a_body_or_a_pose():
    text = xml(
        BOX.replace('pos="0 0 0.03"', 'pos="0 0 0.03" euler="0 0 1.57079632679"')
        + '<body name="base" pos="1 0 0" euler="0 0 1.57079632679"/>'
    )
    plain, turned = make(text, "pusher", "box"), make(text, "pusher", "box", base="base")
    np.testing.assert_allclose(turned.poses()[0, :3], [0.0, 1.3, 0.035], atol=1e-9)
    np.testing.assert_allclose(turned.poses()[1, 3:], [1, 0, 0, 0], atol=1e-9)
    scene = scene_of(turned, [turned.poses()] * 3)
    plain_scene = scene_of(plain, [plain.poses()] * 3)
    turned.restore(scene)
    plain.restore(plain_scene)
    np.testing.assert_allclose(turned.data.qpos, plain.data.qpos, atol=1e-12)


def test_what_does_not_fit_is_named(pushing):
    with pytest.raises(UnknownNameError, match="unknown body of the model 'bax'.*Did you mean 'box'"):
        make(xml(BOX), "bax")
    with pytest.raises(SceneError, match="body 'empty' has no geom that collides"):
        make(xml('<body name="empty"/>'), "empty").meshes()
    with pytest.raises(PwmGymError, match="actuator 'free' has no ctrlrange"):
        make(xml(BOX, actuator='<actuator><motor name="free" joint="x"/></actuator>'), "box")
    with pytest.raises(PwmGymError, match="takes actions of 1 components; expected 3"):
        make(xml(BOX), "box", control=Control((Channel("translation", 0, 3),), period=0.04))
    with pytest.raises(PwmGymError, match="MuJoCo cannot read the model"):
        make("<mujoco><nonsense/></mujoco>", "box")
    with pytest.raises(FileNotFoundError, match=r"no\.xml does not exist"):
        XmlWorld("no.xml")
    with pytest.raises(PwmGymError, match=r"the action has shape \(2,\); expected \(1,\)"):
        pushing.step(np.zeros(2))


@pytest.mark.parametrize(
    ("actuator", "complaint"),
    [
        ('<position name="slow" joint="x" kp="9" timeconst="0.3" ctrlrange="-1 1"/>', "'slow' has an activation"),
        ('<intvelocity name="slow" joint="x" ctrlrange="-1 1" actrange="-1 1"/>', "'slow' has an activation"),
        ('<cylinder name="slow" joint="x" timeconst="0.3" ctrlrange="-1 1"/>', "'slow' has an activation"),
        ('<muscle name="slow" joint="x" force="5" ctrlrange="0 1"/>', "'slow' has an activation"),
        pytest.param(
            '<motor name="slow" joint="x" ctrlrange="-1 1" delay="0.01" nsample="5"/>',
            "'slow' remembers past controls",
            marks=pytest.mark.skipif(not hasattr(mujoco.MjModel, "nhistory"), reason="this MuJoCo has no delays"),
        ),
    ],
    ids=["timeconst", "intvelocity", "cylinder", "muscle", "delay"],
)
def test_an_actuator_with_a_memory_is_refused(actuator, complaint):
    with pytest.raises(PwmGymError, match=complaint):
        make(xml(BOX, actuator=f"<actuator>{actuator}</actuator>"), "pusher", "box")


def _still(model, data, action):
    return np.zeros(1)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"frame_skip": 0}, "frame_skip=0; expected a whole number of at least 1"),
        ({"frame_skip": 2.5}, "frame_skip=2.5; expected a whole number of at least 1"),
        ({"action_size": -1, "act": _still}, "action_size=-1; expected a whole number of at least 0"),
        ({"action_size": 2}, "action_size=2; expected 1, one for each actuator"),
        ({"start": lambda model, data, rng: "there"}, r"`start` returned 'there'; expected a goal \(G,\) or None"),
        ({"start": lambda model, data, rng: 0.3}, r"`start` returned 0.3; expected a goal \(G,\) or None"),
    ],
)
def test_options_that_do_not_fit_are_named(options, complaint):
    with pytest.raises(PwmGymError, match=complaint):
        make(xml(BOX), "pusher", "box", **options)


def test_entities_are_bodies_of_their_own():
    with pytest.raises(PwmGymError, match=r"bodies=\{\}; expected entity -> body"):
        MujocoSimulator.from_xml(xml(BOX), {})
    with pytest.raises(PwmGymError, match="entities 'box' and 'crate' are both body 'box'"):
        MujocoSimulator.from_xml(xml(BOX), {"box": "box", "pusher": "pusher", "crate": "box"})


def test_scenes_that_do_not_fit_are_refused(pushing):
    pushing.reset(0)
    scene = scene_of(pushing, [pushing.poses()] * 3)
    with pytest.raises(SceneError, match=r"scene\.joints is None"):
        pushing.restore(replace(scene, joints=None))
    with pytest.raises(SceneError, match=r"scene\.joints has 3 joints; the simulator's robot has 1"):
        pushing.restore(replace(scene, joints=np.zeros((2, 3))))
    with pytest.raises(SceneError, match="the scene's entities are"):
        pushing.restore(replace(scene, layout=Layout.build([("pusher", 4)])))


def test_a_simulation_that_diverges_names_the_body(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    simulator = make(xml(BOX), "pusher", "box", act=lambda model, data, action: _hurl(data))
    with pytest.raises(PwmGymError, match="diverged: body 'pusher'"):
        for _ in range(20):
            simulator.step(np.ones(1))


@pytest.mark.parametrize("body", [2, 8])
def test_a_position_that_is_no_number_names_its_body(tmp_path, monkeypatch, body):
    """A free body has seven positions and six degrees of freedom."""
    monkeypatch.chdir(tmp_path)
    balls = "".join(f'<body name="ball{k}" pos="{k} 2 1"><freejoint name="ball{k}"/>{SPHERE}</body>' for k in range(9))

    def spoil(model, data, action):
        data.joint(f"ball{body}").qpos[6] = np.nan
        return np.zeros(1)

    simulator = make(xml(balls), "pusher", act=spoil)
    with pytest.raises(PwmGymError, match=f"diverged: body 'ball{body}'"):
        simulator.step(np.zeros(1))


@pytest.mark.parametrize(
    ("returned", "complaint"),
    [
        (None, r"`act` returned None; expected controls \(1,\)"),
        ("no", r"`act` returned 'no'; expected controls \(1,\)"),
        (np.zeros(3), r"`act` returned array.*; expected controls \(1,\)"),
        (np.full(1, np.nan), "control of actuator 'number 0' is nan; expected a finite number"),
    ],
    ids=["None", "text", "size", "nan"],
)
def test_controls_have_to_be_one_number_an_actuator(returned, complaint):
    simulator = make(xml(BOX), "pusher", "box", act=lambda model, data, action: returned)
    with pytest.raises(PwmGymError, match=complaint):
        simulator.step(np.zeros(1))


def test_a_control_that_a_world_of_ones_own_sets_is_checked_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    class Careless(XmlWorld):
        def drive(self, action):
            self.data.ctrl[:] = np.nan

    simulator = MujocoSimulator(Careless(xml(BOX)), {"pusher": "pusher"})
    with pytest.raises(PwmGymError, match="the control of actuator 'number 0' is no finite number"):
        simulator.step(np.zeros(1))


def _hurl(data):
    data.qvel[0] = np.inf
    return np.zeros(1)


def test_an_environment_without_a_model_is_refused():
    with pytest.raises(PwmGymError, match="has no 'model'"):
        RoboticsWorld("CartPole-v1")


SURFACE_XML = """
<mujoco><worldbody><body name="ball"><freejoint/><geom type="sphere" size="0.05"/></body></worldbody></mujoco>
"""


def test_an_entitys_surface_may_be_given():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    simulator = MujocoSimulator.from_xml(SURFACE_XML, {"ball": "ball"}, surfaces={"ball": box})
    assert simulator.meshes()["ball"] is box
    with pytest.raises(UnknownNameError, match="unknown entity 'bal'"):
        MujocoSimulator.from_xml(SURFACE_XML, {"ball": "ball"}, surfaces={"bal": box})
