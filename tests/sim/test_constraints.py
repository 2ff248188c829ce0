"""Loops, welds and mocap bodies of MuJoCo models."""

import numpy as np
import pytest
from mujoco_models import SPHERE, make, run, scene_of, xml

from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.robots import Channel
from pwm_gym.sim.mujoco import MujocoSimulator, layout_of, robot_of

FOUR_BAR = """
    <body name="crank" pos="0 0.3 0.3">
      <joint name="a" type="hinge" axis="0 1 0" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01" mass="0.1"/>
      <body name="rod" pos="0 0 0.1">
        <joint name="b" type="hinge" axis="0 1 0" damping="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01" mass="0.1" contype="0" conaffinity="0"/>
      </body>
    </body>
    <body name="rocker" pos="0.2 0.3 0.3">
      <joint name="c" type="hinge" axis="0 1 0" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01" mass="0.1" contype="0" conaffinity="0"/>
    </body>"""
CONNECT = '<equality><connect body1="rod" body2="rocker" anchor="0.2 0 0" solref="0.004 1"/></equality>'
HAND = """
    <body name="target" mocap="true" pos="0.1 -0.4 0.3">
      <geom type="sphere" size="0.01" contype="0" conaffinity="0"/>
    </body>
    <body name="hand" pos="0.1 -0.4 0.3">
      <joint name="hx" type="slide" axis="1 0 0"/><joint name="hz" type="slide" axis="0 0 1"/>
      <geom type="box" size="0.02 0.03 0.04" mass="0.5"/>
    </body>"""
WELD = '<equality><weld body1="target" body2="hand" relpose="0.01 0 0.02 1 0 0 0"/></equality>'


def test_a_loop_that_a_connection_closes_stays_closed():
    """Of four bars only the crank is an entity: the others' joints follow from it."""
    text = xml(FOUR_BAR, CONNECT)
    simulator, other = (make(text, "pusher", "crank") for _ in range(2))
    simulator.reset(0)
    simulator.data.qvel[1:] = [1.0, -1.0, 1.0]
    poses = run(simulator, np.zeros((6, 1)))
    assert np.abs(simulator.data.qpos[1]) > 0.02  # it swings
    other.restore(scene_of(simulator, poses[-3:][::-1]))
    np.testing.assert_allclose(other.data.qpos[1:], simulator.data.qpos[1:], atol=2e-3)
    tip = other.data.body("rod").xpos + other.data.body("rod").xmat.reshape(3, 3)[:, 0] * 0.2
    rocker = other.data.body("rocker").xpos + other.data.body("rocker").xmat.reshape(3, 3)[:, 2] * 0.1
    np.testing.assert_allclose(tip, rocker, atol=1e-6)
    np.testing.assert_allclose(run(other, np.zeros((5, 1)))[-1], run(simulator, np.zeros((5, 1)))[-1], atol=5e-3)


CRANKED = '<actuator><position joint="a" kp="2" ctrlrange="-0.6 0.6"/></actuator>'
SLIDES = """
    <joint name="c" type="slide" axis="1 0 0" damping="0.02"/><joint type="slide" axis="0 0 1" damping="0.02"/>"""


@pytest.mark.parametrize(
    ("bars", "equality"),
    [
        (FOUR_BAR, CONNECT),
        (
            FOUR_BAR.replace('<joint name="c" type="hinge" axis="0 1 0" damping="0.02"/>', SLIDES),
            '<equality><weld body1="rod" body2="rocker" solref="0.004 1"/></equality>',
        ),
    ],
    ids=["connect", "weld"],
)
def test_a_robots_loop_stays_closed_though_its_other_side_is_no_entity(bars, equality):
    simulator, other = (make(xml(bars, equality, CRANKED), "crank") for _ in range(2))
    simulator.reset(0)
    poses = run(simulator, np.full((8, 1), 0.8))
    rocker = simulator.data.body("rocker").xpos
    joint = simulator.model.joint("c").qposadr[0]
    assert abs(simulator.data.qpos[joint]) > 0.02
    other.restore(scene_of(simulator, poses[-3:][::-1]))
    np.testing.assert_allclose(other.data.body("rocker").xpos, rocker, atol=2e-3)
    np.testing.assert_allclose(other.data.qpos[joint], simulator.data.qpos[joint], atol=2e-3)
    np.testing.assert_allclose(other.data.qvel, simulator.data.qvel, atol=0.1)
    np.testing.assert_allclose(
        run(other, np.full((5, 1), 0.8))[-1], run(simulator, np.full((5, 1), 0.8))[-1], atol=2e-3
    )


def test_a_mocap_body_goes_where_the_weld_to_its_link_is_satisfied():
    simulator = MujocoSimulator.from_xml(
        xml(HAND, WELD, ""),
        {"hand": "hand"},
        act=lambda model, data, action: _move_mocap(data, action),
        action_size=2,
    )
    simulator.reset(0)
    assert simulator.joints().shape == (2, 2)  # the hand's: what the mocap body drives; nothing drives the pusher
    poses = run(simulator, np.tile([[0.2, 0.1]], (20, 1)))
    assert poses[-1, 0, 0] > poses[0, 0, 0] + 0.05
    simulator.restore(scene_of(simulator, poses[-3:][::-1], joints=simulator.joints() * [[1.0], [0.0]]))
    np.testing.assert_allclose(simulator.poses(), poses[-1], atol=1e-6)
    before = simulator.poses()
    simulator.step(np.zeros(2))
    np.testing.assert_allclose(simulator.poses(), before, atol=1e-3)  # it rests where it is


SITES = "".join(f'<site name="s{k}" pos="0 0 {k}"/>' for k in range(9))  # more than there are bodies
SITED = SITES + HAND.replace("</body>", '<site name="at" pos="0.01 0 0.02" euler="0 0.3 0"/></body>', 1).replace(
    'mass="0.5"/>', 'mass="0.5"/><site name="grip" euler="0 0.3 0"/>'
)
FREE_HAND = HAND.replace(
    '<joint name="hx" type="slide" axis="1 0 0"/><joint name="hz" type="slide" axis="0 0 1"/>', "<freejoint/>"
)
TURNED = '<equality><weld body1="target" body2="hand" relpose="0.01 0 0.02 0.8 0 0 0.6"/></equality>'
MOCAP_HAND = """
    <body name="hand" mocap="true" pos="0.1 -0.4 0.3"><geom type="box" size="0.02 0.03 0.04" mass="0.5"/></body>"""


@pytest.mark.parametrize(
    ("hand", "equality"),
    [
        (SITED, '<equality><weld site1="at" site2="grip"/></equality>'),
        (SITED, '<equality><weld site1="grip" site2="at"/></equality>'),
        (HAND, '<equality><connect body1="target" body2="hand" anchor="0.05 0 0"/></equality>'),
        (HAND, '<equality><connect body1="hand" body2="target" anchor="0.05 0 0"/></equality>'),
        (SITED, '<equality><connect site1="grip" site2="at"/></equality>'),
        (FREE_HAND, TURNED),
        (MOCAP_HAND, ""),
    ],
    ids=["weld by sites", "the other way", "connect", "its other way", "by sites", "free hand", "mocap hand"],
)
def test_what_a_mocap_body_pulls_and_what_it_is_are_restored(hand, equality):
    simulator = MujocoSimulator.from_xml(
        xml(hand, equality, ""),
        {"hand": "hand", "pusher": "pusher"},
        act=lambda model, data, action: _move_mocap(data, action),
        action_size=2,
    )
    assert simulator.links == {"hand"}
    layout = layout_of(simulator, points=4)
    assert layout["hand"].driven and [layout.names[k] for k in layout.hands] == ["hand"]
    assert [*robot_of(simulator, "hand", [Channel("joint", 0, 2)]).links] == ["hand"]
    simulator.reset(0)
    start = simulator.poses()[0]
    run(simulator, np.tile([[0.2, 0.1]], (20, 1)))
    poses = run(simulator, np.zeros((60, 2)))[-1]
    assert poses[0, 0] > start[0] + 0.1
    scene = scene_of(simulator, [poses] * 3)
    mocap = simulator.data.mocap_pos.copy(), simulator.data.mocap_quat.copy()
    simulator.reset(1)
    simulator.restore(scene)
    np.testing.assert_allclose(simulator.poses(), poses, atol=1e-6)
    np.testing.assert_allclose(simulator.data.mocap_pos, mocap[0], atol=2e-3)
    np.testing.assert_allclose(simulator.data.mocap_quat, mocap[1], atol=2e-3)
    simulator.step(np.zeros(2))
    np.testing.assert_allclose(simulator.poses(), poses, atol=2e-3)


def test_a_free_hand_goes_on_at_its_speed_and_is_not_placed():
    simulator, other = (
        make(
            xml(FREE_HAND, TURNED, ""), "hand", act=lambda model, data, action: _move_mocap(data, action), action_size=2
        )
        for _ in range(2)
    )
    poses = run(simulator, np.tile([[0.2, 0.1]], (20, 1)))
    other.restore(scene_of(simulator, poses[-3:][::-1]))
    np.testing.assert_allclose(other.data.qvel, simulator.data.qvel, atol=0.1)  # their mean of a step
    with pytest.raises(SceneError, match="'hand' is no free body"):
        other.place("hand", poses[0, 0])


def test_what_hangs_on_a_mocap_body_that_is_no_entity_is_refused():
    act = {"act": lambda model, data, action: _move_mocap(data, action), "action_size": 2}
    palm = MOCAP_HAND.replace('name="hand"', 'name="wrist"').replace(
        "</body>", f'<body name="palm">{SPHERE}</body></body>'
    )
    with pytest.raises(PwmGymError, match="entity 'palm' hangs on mocap body 'wrist'.*expected 'wrist'"):
        make(xml(palm, "", ""), "palm", **act)
    named = TURNED.replace("<weld", '<weld name="glue"')
    with pytest.raises(PwmGymError, match="body 'hand' has a free joint, and weld 'glue' binds.*'target'; expected it"):
        make(xml(FREE_HAND, named, ""), "pusher", **act)


def _move_mocap(data, action):
    data.mocap_pos[0, [0, 2]] += 0.05 * action
    return np.zeros(0)
