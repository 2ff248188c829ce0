"""What a MuJoCo model tells of its robot and its scene, and what is refused."""

import numpy as np
import pytest
import torch
import trimesh

from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.robots import Channel
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Scene, Support
from pwm_gym.scene.joint import Mimic
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sim.mujoco import MujocoSimulator, layout_of, robot_of

ROOM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <geom name="table" type="box" size="0.3 0.4 0.1" pos="0.5 0 0.1"/>
    <geom name="shade" type="sphere" size="0.1" pos="0 0 2" contype="0" conaffinity="0"/>
    <body name="upper" pos="0 0 0.3" euler="0 0 0.3">
      <joint name="shoulder" type="hinge" axis="0 0 1" range="-2 2" damping="1" ref="0.2"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
      <body name="fore" pos="0.3 0 0">
        <joint name="elbow" type="hinge" axis="0 0.6 0.8" pos="0 0.02 0.03" damping="1"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/>
        <body name="plate" pos="0.2 0 0"><geom type="box" size="0.01 0.03 0.03"/></body>
        <body name="jaw" pos="0.22 0.02 0">
          <joint name="jaw" type="slide" axis="0 1 0" range="0 0.03"/>
          <geom type="box" size="0.01 0.005 0.01"/>
        </body>
        <body name="other" pos="0.22 -0.02 0">
          <joint name="other" type="slide" axis="0 -1 0" range="0 0.03"/>
          <geom type="box" size="0.01 0.005 0.01"/>
        </body>
      </body>
    </body>
    <body name="box" pos="0.5 0 0.23"><freejoint/><geom type="box" size="0.03 0.03 0.03"/></body>
    <body name="post" pos="0 1 0.5"><geom type="cylinder" size="0.05 0.5"/>
      <body name="door" pos="0.3 0 0">
        <joint name="hinge" type="hinge" axis="0 0 1" pos="-0.25 0.02 0" range="0 1.5"/>
        <geom type="box" size="0.2 0.02 0.4"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="other" joint2="jaw" polycoef="0.001 1 0 0 0"/></equality>
  <actuator>
    <motor joint="shoulder" ctrlrange="-1 3"/>
    <position joint="elbow" kp="10" ctrlrange="-1 1"/>
    <position joint="jaw" kp="10" ctrlrange="0 0.03"/>
  </actuator>
</mujoco>
"""
LINKS = ("upper", "fore", "plate", "jaw", "other")
NAMES = (*LINKS, "box", "post", "door")


def make(text=ROOM, names=NAMES, **options):
    return MujocoSimulator.from_xml(text, {name: name for name in names}, **options)


@pytest.fixture(scope="module")
def room():
    return make()


def test_links_joints_and_actuators_are_those_of_the_model(room):
    robot = robot_of(room, "crane")
    assert tuple(robot.links) == LINKS and robot.control.period == pytest.approx(0.04)
    assert robot.control.channels == (Channel("joint", 0, 1, rest=-0.5), Channel("joint", 1, 3, rest=None))
    kinds = {name: (joint.kind, joint.parent) for name, joint in robot.joints.items()}
    assert kinds == {
        "upper": ("revolute", None),
        "fore": ("revolute", "upper"),
        "plate": ("fixed", "fore"),
        "jaw": ("prismatic", "fore"),
        "other": ("prismatic", "fore"),
    }
    assert robot.joints["other"].mimic == Mimic("jaw", 1.0, 0.001)
    assert (robot.joints["upper"].lower, robot.joints["upper"].upper) == pytest.approx((-2.0, 2.0))
    layout = layout_of(room, points=20)
    assert layout["door"].articulated and layout["box"].loose and layout["post"].joint.kind == "fixed"
    assert layout.supports == (Support.ground(), Support((0.5, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0), (0.3, 0.4, 0.1)))


def test_joint_positions_are_the_simulators_and_place_every_entity(room):
    """Of hinges that pass beside their bodies' origins and whose reference is not 0, too."""
    layout = layout_of(room, points=4)
    moving = [k for k, e in enumerate(layout) if e.joint.moves]
    tree = JointTree(layout, moving, layout.attached)
    rng = np.random.default_rng(0)
    for _ in range(3):
        room.reset(0)
        room.data.qpos[:4] = rng.uniform(-1.0, 1.0, 2).tolist() + [0.01, 0.011]
        room.data.qpos[-1] = rng.uniform(0.0, 1.5)
        room._forward()
        frames = matrix_from_pose7(torch.as_tensor(room.poses())).float()
        positions = tree.positions(frames)
        np.testing.assert_allclose(positions[:4], room.data.qpos[:4], atol=1e-5)
        assert positions[4] == pytest.approx(room.data.qpos[-1], abs=1e-5)
        np.testing.assert_allclose(tree.place(frames, positions), frames, atol=1e-5)


def test_surfaces_and_scenes_go_with_frames_on_hinges(room):
    assert room.meshes()["door"].bounds[:, :2] == pytest.approx(np.array([[0.05, -0.04], [0.45, 0.0]]))
    room.reset(0)
    room.data.qpos[-1] = 0.7
    room._forward()
    poses, qpos = room.poses(), room.data.qpos.copy()
    door = trimesh.transform_points(room.meshes()["door"].vertices, matrix_from_pose7(torch.as_tensor(poses[-1])))
    geom = room.data.geom_xpos[room.model.body("door").geomadr[0]]
    np.testing.assert_allclose(0.5 * (door.min(0) + door.max(0)), geom, atol=1e-6)
    np.testing.assert_allclose(room.pose("door"), poses[-1], atol=1e-9)
    layout = layout_of(room, points=4)
    scene = Scene("X", layout, np.zeros((layout.points, 3)), np.stack([poses] * 3), np.zeros(0), room.joints())
    room.reset(0)
    room.restore(scene)
    np.testing.assert_allclose(room.data.qpos, qpos, atol=1e-6)
    np.testing.assert_allclose(room.poses(), poses, atol=1e-6)


def test_a_link_on_several_joints_is_a_hand():
    simulator = make(names=("fore", "jaw", "box", "post", "door"))
    robot = robot_of(simulator, "gripper")
    assert list(robot.joints) == ["jaw"] and robot.joints["jaw"].parent == "fore"
    layout = layout_of(simulator, points=4)
    assert [layout.names[k] for k in layout.hands] == ["fore"] and layout["fore"].driven


def test_what_a_model_does_not_tell_has_to_be_said():
    with pytest.raises(PwmGymError, match="expected those first"):
        robot_of(make(names=("box", *LINKS)), "crane")
    with pytest.raises(PwmGymError, match="expected `channels` that tell it"):
        robot_of(make(act=lambda model, data, action: action), "crane")
    told = [Channel("joint", 0, 3)]
    assert robot_of(make(act=lambda model, data, action: action), "crane", told).control.channels == tuple(told)
    with pytest.raises(PwmGymError, match="geom 'number 9' of body 'post' can be touched.*expected its body among"):
        layout_of(make(names=(*LINKS, "box", "door")))


ROPES = "<tendon><spatial name='rope' {}><site site='a'/><site site='b'/></spatial></tendon>"
COUPLINGS = {
    "spring": (ROPES.format("stiffness='50'"), "tendon 'rope' couples bodies 'fore' and 'box'"),
    "limit": (ROPES.format("range='0 0.5' limited='true'"), "tendon 'rope' couples bodies 'fore' and 'box'"),
    "equality": (
        ROPES.format("") + "<equality><tendon name='tie' tendon1='rope'/></equality>",
        "tendon equality 'tie' couples bodies 'fore' and 'box'",
    ),
    "joints": (
        "<equality><joint name='cam' joint1='hinge' joint2='elbow' polycoef='0 1 2 0 0'/></equality>",
        "joint equality 'cam', which is not linear, couples bodies 'door' and 'fore'",
    ),
}


@pytest.mark.parametrize(("more", "complaint"), COUPLINGS.values(), ids=COUPLINGS)
def test_what_couples_entities_without_a_touch_is_refused(more, complaint):
    text = ROOM.replace('<body name="plate"', '<site name="a"/><body name="plate"').replace(
        "<freejoint/>", '<freejoint/><site name="b"/>'
    )
    with pytest.raises(PwmGymError, match=complaint):
        layout_of(make(text.replace("</mujoco>", f"{more}</mujoco>")))


def test_what_couples_nothing_or_the_robot_alone_is_not():
    text = ROOM.replace('<body name="plate"', '<site name="a"/><body name="plate"')
    rope = ROPES.format("stiffness='50'")
    cam = "<equality><joint joint1='jaw' joint2='elbow' polycoef='0 1 2 0 0'/></equality>"
    own = text.replace('<joint name="shoulder"', '<site name="b"/><joint name="shoulder"')
    layout_of(make(own.replace("</mujoco>", f"{rope}{cam}</mujoco>")))
    slack = text.replace("<freejoint/>", '<freejoint/><site name="b"/>')
    layout_of(make(slack.replace("</mujoco>", f"{ROPES.format('')}</mujoco>")))


MOVING = {
    "free": '<body name="loose" pos="0 0 3"><freejoint/><geom name="skin" size="0.05"/></body>',
    "pendulum": '<body name="loose" pos="0 0 3"><joint/><geom name="skin" size="0.05"/></body>',
    "on a fixed body": """
        <body pos="0 2 3"><body name="loose"><joint/><geom name="skin" size="0.05"/></body></body>""",
    "mocap": '<body name="loose" pos="0 0 3" mocap="true"><geom name="skin" type="box" size="0.1 0.1 0.1"/></body>',
    "height field": """
        <body name="loose" pos="0 0 3"><freejoint/><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
        <geom name="skin" type="hfield" hfield="hills"/></body>""",
}


@pytest.mark.parametrize("body", MOVING.values(), ids=MOVING)
def test_what_moves_and_can_be_touched_has_to_be_an_entity(body):
    text = ROOM.replace("<worldbody>", f"<asset>{HILLS}</asset><worldbody>{body}")
    with pytest.raises(PwmGymError, match="geom 'skin' of body 'loose' can be touched and moves.*among the entities"):
        layout_of(make(text))
    layout_of(make(text.replace('name="skin"', 'name="skin" contype="0" conaffinity="0"')))


def test_a_cable_has_to_be_entities():
    cable = """
        <composite prefix="rope" type="cable" curve="s" count="4 1 1" size="0.5" offset="0 0 3">
          <joint kind="main" damping="0.01"/><geom type="capsule" size="0.01"/>
        </composite>"""
    with pytest.raises(PwmGymError, match="of body 'ropeB_first' can be touched and moves"):
        layout_of(make(ROOM.replace("<worldbody>", f"<worldbody>{cable}")))


BODY = '<body name="thing" pos="0 0 1"><freejoint/>{geom}<site name="eye"/></body>'
BALL = '<geom size="0.05"/>'


BALLS = BODY.format(geom=BALL)


def world(asset="", body=BALLS, more=""):
    return f"<mujoco><asset>{asset}</asset><worldbody>{body}</worldbody>{more}</mujoco>"


HILLS = '<hfield name="hills" nrow="3" ncol="3" size="1 1 0.2 0.1"/>'
FLAT = '<mesh name="flat" inertia="shell" vertex="0 0 0 1 0 0 0 1 0 1 1 0" face="0 1 2 1 3 2"/>'
ROPE = """
    <tendon><spatial name="rope"><site site="hook"/><site site="eye"/></spatial></tendon>
    <actuator><motor tendon="rope" ctrlrange="-1 1"/></actuator>"""
SEEN = '<site name="hook"/>'
SUCTION = '<actuator><adhesion name="suck" body="thing" ctrlrange="0 1" gain="5"/></actuator>'
CRANK = """
    <actuator>
      <general name="push" cranksite="eye" slidersite="hook" cranklength="0.4" ctrlrange="-1 1"/>
    </actuator>"""
CLOTH = '<flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" mass="1" dim="2" rigid="true"/>'


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (world(body='<site name="hook"/>' + BODY.format(geom=BALL), more=ROPE), "body 'thing' is free or a ball"),
        (
            world(body=SEEN + BALLS, more=ROPE.replace("<motor", '<motor name="pull"')),
            "actuator 'pull' through tendon 'rope'",
        ),
        (
            world(more=SUCTION),
            "body 'thing' is free or a ball, driven by actuator 'suck' through adhesion of body 'thing'",
        ),
        (world(body=SEEN + BALLS, more=CRANK), "actuator 'push' drives a slider-crank by site 'eye'"),
        (world(body=CLOTH + BODY.format(geom=BALL)), "flexible body 'cloth'"),
        (world(HILLS, BODY.format(geom=BALL) + '<geom name="land" type="hfield" hfield="hills"/>'), "'land'.*height"),
        (world(FLAT, BODY.format(geom='<geom type="mesh" mesh="flat" mass="1"/>')), "mesh 'flat' has coplanar"),
        (world(body=BODY.format(geom=BALL) + 200 * f"<body>{BALL}</body>"), "has 202 bodies; expected 200 at most"),
        (
            world('<mesh name="m" file="gone.stl"/>', BODY.format(geom='<geom type="mesh" mesh="m"/>')),
            "gone.stl.*of mesh 'm'",
        ),
        (
            world('<mesh name="m" file="/no/m.stl"/>', BODY.format(geom='<geom type="mesh" mesh="m"/>')),
            "/no/m.stl.*of mesh 'm'",
        ),
    ],
    ids=[
        "tendon",
        "named tendon",
        "adhesion",
        "slider-crank",
        "flex",
        "height field",
        "flat mesh",
        "many bodies",
        "missing mesh",
        "absolute path",
    ],
)
def test_what_is_not_supported_is_named(text, complaint):
    with pytest.raises(PwmGymError, match=complaint):
        layout_of(make(text, ["thing"]))


def test_an_entitys_height_field_or_plane_is_refused():
    land = '<body name="land"><geom name="land" type="hfield" hfield="hills"/></body>'
    with pytest.raises(SceneError, match="geom 'land' of body 'land' is a height field; expected a mesh"):
        make(world(HILLS, land), ["land"]).meshes()
    with pytest.raises(SceneError, match="body 'ground' has no geom that collides, planes apart"):
        make(world(body='<body name="ground"><geom type="plane" size="1 1 1"/></body>'), ["ground"]).meshes()


def test_a_model_with_an_absolute_path_is_read(tmp_path):
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "block.stl")
    asset = f'<mesh name="block" file="{tmp_path / "block.stl"}"/>'
    simulator = make(world(asset, BODY.format(geom='<geom type="mesh" mesh="block" mass="1"/>')), ["thing"])
    assert simulator.meshes()["thing"].extents == pytest.approx([0.1, 0.2, 0.3], rel=1e-4)


def test_fixed_bodies_are_placed_where_a_scene_has_them():
    def start(model, data, rng):
        model.body("post").pos[:2] = rng.uniform(0.8, 1.2, 2)

    first, second = (make(start=start, placed=["post"]) for _ in range(2))
    first.reset(1)
    first.data.qpos[-1] = 0.4
    first._forward()
    second.reset(2)
    assert np.abs(first.pose("post") - second.pose("post")).max() > 0.01
    poses = np.stack([first.poses()] * 3)
    layout = layout_of(first, points=4)
    second.restore(Scene("X", layout, np.zeros((layout.points, 3)), poses, np.zeros(0), first.joints()))
    np.testing.assert_allclose(second.poses(), first.poses(), atol=1e-6)
    with pytest.raises(PwmGymError, match="'box' is not fixed to the world"):
        make(placed=["box"])
