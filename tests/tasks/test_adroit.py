"""The Adroit tasks in their simulator: the hand's description, rewards, restoring, experts."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from scipy.spatial.transform import Rotation

from pwm_gym.costs import cost_info, doors
from pwm_gym.costs.adroit import PALM_PLACE
from pwm_gym.errors import SceneError
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sim.mujoco import robot_of
from pwm_gym.tasks import get_task

NAMES = ("AdroitHandDoor", "AdroitHandRelocate")


@pytest.fixture(scope="module")
def twins():
    """Each task's twin, made once."""
    made = {name: gym.make(f"pwm/{name}Sim-v0").unwrapped for name in NAMES}
    yield made
    for twin in made.values():
        twin.close()


def explore(twin, steps, seed=0):
    """Costs' rewards and the simulator's (T,) along an explorer's way."""
    twin.reset(seed=seed)
    explorer = twin.task.expert(np.random.default_rng(seed))
    found = []
    for _ in range(steps):
        scene = twin.scene()
        _, reward, _, _, info = twin.step(explorer.act(scene.poses[0], scene.goal))
        found.append((reward, info["simulator_reward"]))
    return np.array(found).T


def look(twin):
    """Clouds of the present instant, and what costs read besides."""
    return cost_info(twin.state, torch.zeros(1, twin.task.action_size), twin.goal, twin.rules.grasp)


@pytest.mark.parametrize("name", NAMES)
def test_the_hand_is_described_as_the_model_has_it(twins, name):
    simulator, robot = twins[name].simulator, get_task(name).robot
    read = robot_of(simulator, name)
    assert robot.joints.keys() == read.joints.keys() and robot.links == read.links
    for link, joint in read.joints.items():
        own = robot.joints[link]
        assert (own.kind, own.parent) == (joint.kind, joint.parent)
        for field in ("origin", "axis", "lower", "upper"):
            np.testing.assert_allclose(getattr(own, field), getattr(joint, field), atol=1e-3)
    assert robot.control.size == read.control.size and robot.control.period == read.control.period
    actuators = tuple(simulator.model.actuator(k).name.removeprefix("A_") for k in range(simulator.model.nu))
    assert robot.action_names == actuators


@pytest.mark.parametrize("name", NAMES)
def test_the_links_hang_on_their_joints(twins, name):
    twin = twins[name]
    explore(twin, 6)
    layout = twin.task.layout
    tree = JointTree(layout, [k for k, e in enumerate(layout) if e.joint.moves])
    frames = matrix_from_pose7(torch.as_tensor(twin.simulator.poses())).float()
    positions = tree.positions(frames)
    fingers = twin.simulator.joints()[0, -24:]
    np.testing.assert_allclose(positions[:24], fingers, atol=2e-3)
    np.testing.assert_allclose(tree.place(frames, positions), frames, atol=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_the_simulators_reward_is_the_environments(twins, name):
    simulator, rng = twins[name].simulator, np.random.default_rng(1)
    simulator.reset(2)
    for _ in range(20):
        outcome = simulator.step(rng.uniform(-1, 1, simulator.action_size))
        assert outcome.reward == pytest.approx(simulator.world.reward, abs=2e-3)  # its sites lag by a step of 2 ms


@pytest.mark.parametrize(("name", "noise"), [("AdroitHandDoor", 4e-3), ("AdroitHandRelocate", 2e-3)])
def test_the_cost_is_minus_the_environments_dense_reward(twins, name, noise):
    found, wanted = explore(twins[name], 25)
    np.testing.assert_allclose(found, wanted, atol=3 * noise)
    assert np.median(np.abs(found - wanted)) < noise
    assert np.corrcoef(found, wanted)[0, 1] > 0.95


def place_door(twin, opened, turned):
    """The door and its latch at angles, at rest, as a scene of the twin."""
    simulator = twin.simulator
    twin.reset(seed=3)
    simulator.data.joint("door_hinge").qpos[0] = opened
    simulator.data.joint("latch").qpos[0] = turned
    simulator._forward()
    poses = np.stack([simulator.poses()] * 3)
    twin.reset(options={"scene": replace(twin.scene(truth=True), poses=poses, joints=simulator.joints())})


def test_a_latch_may_be_pressed_past_its_soft_limit(twins):
    twin, task = twins["AdroitHandDoor"], get_task("AdroitHandDoor")
    twin.reset(seed=3)
    first = twin.scene(truth=True)

    def scene(turned):
        twin.simulator.data.joint("latch").qpos[0] = turned
        twin.simulator._forward()
        return replace(first, poses=np.stack([twin.simulator.poses()] * 3))

    assert scene(2.04).validate(task.name, task.layout, task.goal_size)  # its limit is at 1.8
    with pytest.raises(SceneError, match=r"the joint of 'latch' is at 2\.4"):
        scene(2.4).validate(task.name, task.layout, task.goal_size)


@pytest.mark.parametrize(("opened", "turned"), [(0.0, 0.0), (0.3, 1.6), (1.1, 0.8), (1.45, 1.8)])
def test_clouds_tell_the_door_its_latch_and_the_palm(twins, opened, turned):
    twin = twins["AdroitHandDoor"]
    place_door(twin, opened, turned)
    data = twin.simulator.data
    points, info = look(twin)
    assert float(doors.angle(doors.ADROIT_DOOR)(points, info)) == pytest.approx(opened, abs=0.02)
    assert float(doors.latch_angle(doors.ADROIT_DOOR)(points, info)) == pytest.approx(turned, abs=0.06)
    handle = doors.handle(doors.ADROIT_DOOR)(points, info)[0]
    np.testing.assert_allclose(handle, data.site("S_handle").xpos, atol=0.02)
    np.testing.assert_allclose(PALM_PLACE(points, info)[0], data.site("S_grasp").xpos, atol=3e-3)
    cost, reward = float(twin.rules.cost(points, info)), twin.simulator.outcome().reward
    assert -cost == pytest.approx(reward, abs=0.02)
    assert twin.simulator.outcome().success == (opened > 1.35)


@pytest.mark.parametrize("above", [0.0, 0.03, 0.07])
def test_a_ball_in_the_air_near_its_goal_is_worth_as_much_as_in_the_environment(twins, above):
    twin = twins["AdroitHandRelocate"]
    twin.reset(seed=4)
    pose = np.r_[twin.simulator.goal() + [0.0, 0.0, above], 1.0, 0.0, 0.0, 0.0]
    twin.simulator.place("ball", pose)
    poses = np.stack([twin.simulator.poses()] * 3)
    twin.reset(options={"scene": replace(twin.scene(truth=True), poses=poses, joints=twin.simulator.joints())})
    points, info = look(twin)
    reward = twin.simulator.outcome().reward
    assert reward > 10.0 and -float(twin.rules.cost(points, info)) == pytest.approx(reward, abs=5e-3)


def test_a_ball_that_has_rolled_anywhere_is_restored(twins):
    """Its six joints in a row pass through where two of them turn about one axis."""
    twin = twins["AdroitHandRelocate"]
    simulator = twin.simulator
    twin.reset(seed=5)
    scene = twin.scene(truth=True)
    turns = [*Rotation.random(12, rng=0), Rotation.from_euler("XYZ", [0.3, np.pi / 2, 0.2])]
    for turn in turns:
        poses = scene.poses.copy()
        poses[:, -1, :3] = [0.1, 0.2, 0.3]
        poses[:, -1, 3:] = turn.as_quat(canonical=True, scalar_first=True)
        simulator.restore(replace(scene, poses=poses, joints=simulator.joints()))
        np.testing.assert_allclose(simulator.poses()[-1], poses[0, -1], atol=1e-5)
        assert np.abs(simulator.data.qvel[-6:]).max() < 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_of_an_episode_has_the_same_future(twins, name):
    twin, task = twins[name], get_task(name)
    explore(twin, 12, seed=6)
    scene = twin.scene(truth=True)
    actions = np.random.default_rng(2).uniform(-1, 1, (5, task.action_size)).astype(np.float32)
    wanted = [after(twin.simulator, a) for a in actions]
    other = task.make_simulator()
    other.restore(scene)
    np.testing.assert_allclose(other.poses(), scene.poses[0], atol=1e-5)
    np.testing.assert_array_equal(other.goal(), scene.goal)
    found = [after(other, a) for a in actions]
    np.testing.assert_allclose(found, wanted, atol=5e-3)
    other.restore(scene)
    np.testing.assert_array_equal([after(other, a) for a in actions], found)
    with pytest.raises(SceneError, match="has 9 joints; the simulator's robot has"):
        other.restore(replace(scene, joints=np.zeros((2, 9))))
    other.close()


def after(simulator, action):
    simulator.step(action)
    return simulator.poses()


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_episode_bit_for_bit(twins, name):
    simulator = twins[name].simulator
    actions = np.random.default_rng(0).uniform(-1, 1, (4, simulator.action_size)).astype(np.float32)

    def episode():
        simulator.reset(7)
        return np.array([simulator.poses(), *[after(simulator, a) for a in actions]])

    first = episode()
    simulator.reset(8)
    assert np.abs(simulator.poses() - first[0]).max() > 1e-3
    np.testing.assert_array_equal(episode(), first)


def test_the_twin_passes_gymnasiums_checks(twins):
    check_env(twins["AdroitHandRelocate"], skip_render_check=True)


@pytest.mark.parametrize(("name", "seeds", "least"), [("AdroitHandDoor", 6, 3), ("AdroitHandRelocate", 4, 4)])
def test_the_expert_succeeds(twins, name, seeds, least):
    twin = twins[name]
    assert sum(succeeds(twin.simulator, twin.task, seed) for seed in range(seeds)) >= least


def succeeds(simulator, task, seed):
    """Whether the expert gets there within an episode's steps."""
    simulator.reset(seed)
    expert = task.expert(np.random.default_rng(seed))
    return any(
        simulator.step(expert.act(simulator.poses(), simulator.goal())).success for _ in range(task.max_episode_steps)
    )
