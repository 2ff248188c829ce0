"""Skills are stateless: each phase is told from poses, which a kinematic stand-in for a simulator gives them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError
from pwm_gym.robots.panda import PANDA
from pwm_gym.skills import Place, TopGrasp, drive, yaw_error

WIDTH, OBJECT = 0.05, 3
DOWN = Rotation.from_euler("x", np.pi)
TOOL = 0.1034  # metres from the hand to the tool


class World:
    """A hand that does exactly what it is told, and a box that it carries while it holds it."""

    def __init__(self, tool=(0.5, 0.1, 0.3), box=(0.6, 0.0, 0.025), yaw=0.0, opening=0.08):
        self.tool, self.box, self.opening = np.array(tool), np.array(box), opening
        self.yaw, self.box_yaw = 0.0, yaw
        self.lowest = np.inf

    def poses(self):
        turn = Rotation.from_euler("z", self.yaw) * DOWN
        axis = turn.apply([0.0, 1.0, 0.0])
        hand = self.tool + [0.0, 0.0, TOOL]
        box = Rotation.from_euler("z", self.box_yaw).as_quat(scalar_first=True)
        rows = [np.r_[hand + side * 0.5 * self.opening * axis, turn.as_quat(scalar_first=True)] for side in (0, 1, -1)]
        return np.stack([*rows, np.r_[self.box, box]])

    def step(self, action):
        shut = action[-1] < 0
        near = np.linalg.norm(self.tool - self.box) < 0.015
        held = shut and near and self.opening <= WIDTH + 1e-6
        floor = WIDTH if near else 0.0
        self.opening = max(self.opening - 0.02, floor) if shut else min(self.opening + 0.02, 0.08)
        self.tool = self.tool + 0.1 * action[:3]
        self.yaw -= 0.1 * action[5]
        if held:
            self.box = self.box + 0.1 * action[:3]


def grasp(**settings):
    return TopGrasp(PANDA, OBJECT, WIDTH, speed=0.02, **settings)


@pytest.mark.parametrize("yaw", [0.0, 0.4, -0.7, 2.0])
def test_a_grasp_comes_from_above_and_aligned(yaw):
    world, skill = World(yaw=yaw), grasp()
    for _ in range(120):
        if skill.holds(world.poses()):
            break
        before = world.tool.copy()
        world.step(skill.act(world.poses()))
        if world.tool[2] < 0.06 < before[2]:  # where it passes the object's top
            assert np.linalg.norm(world.tool[:2] - world.box[:2]) < 0.02
            assert abs(yaw_error(PANDA.tool(world.poses()), world.poses()[OBJECT])) < 0.13
    assert skill.holds(world.poses())
    assert np.linalg.norm(world.tool - world.box) < 0.015


def test_a_low_tool_rises_before_it_moves_over():
    world = World(tool=(0.4, 0.1, 0.03))
    action = grasp().act(world.poses())
    assert action[2] > 0.15 and np.abs(action[:2]).max() < 1e-6


def test_shut_fingers_beside_the_object_hold_nothing():
    assert not grasp().holds(World(tool=(0.6, 0.1, 0.025), opening=WIDTH).poses())
    assert not grasp().holds(World(tool=(0.6, 0.0, 0.025), opening=0.0).poses())
    assert grasp().holds(World(tool=(0.6, 0.0, 0.025), opening=WIDTH).poses())


def test_a_place_is_reached_from_above_and_left():
    target = np.array([0.45, 0.15, 0.065])
    world = World(tool=(0.6, 0.0, 0.025), opening=WIDTH)
    skill = Place(PANDA, OBJECT, WIDTH, speed=0.02, clearance=0.03)
    for _ in range(80):
        if skill.placed(world.poses(), target):
            break
        world.step(skill.carry(world.poses(), target))
        if np.linalg.norm(world.box[:2] - target[:2]) < 0.05:
            assert world.box[2] > target[2] - 1e-3
    assert skill.placed(world.poses(), target)
    left = world.box.copy()
    for _ in range(20):
        world.step(skill.release(world.poses()))
    np.testing.assert_array_equal(world.box, left)
    assert world.opening == pytest.approx(0.08) and world.tool[2] - left[2] == pytest.approx(skill.retreat, abs=5e-3)


def test_a_motion_is_as_fast_as_it_may_be():
    action = drive(PANDA, np.array([0.3, 0.0, 0.4]), speed=0.02, gripper=-1.0, turn=5.0)
    np.testing.assert_allclose(action, [0.12, 0.0, 0.16, 0.0, 0.0, -1.0, -1.0], atol=1e-6)
    small = drive(PANDA, np.array([0.001, 0.0, 0.0]), speed=0.02, gripper=1.0)
    np.testing.assert_allclose(small, [0.01, 0, 0, 0, 0, 0, 1.0], atol=1e-6)


def test_a_robot_without_a_tool_is_refused():
    blind = replace(PANDA, tool=None)
    with pytest.raises(PwmGymError, match="robot 'panda' has no tool"):
        TopGrasp(blind, OBJECT, WIDTH, 0.02).act(World().poses())
