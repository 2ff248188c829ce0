"""OGBench's Cube tasks in their simulator: oracle, rewards, restoring, evaluation tasks, description of the robot."""

import sys
from itertools import groupby

import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.costs import contacts, cost_info, get_cost
from pwm_gym.costs.several import Several
from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.robots.gripper import ROBOTIQ
from pwm_gym.robots.joints import JointTree
from pwm_gym.robots.kinematics import ArmKinematics
from pwm_gym.robots.ur5e import UR5E, opening, tool_pose
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.seeds import seed_range
from pwm_gym.sim.mujoco import ogbench_play
from pwm_gym.sim.mujoco.ogbench import CubeWorld
from pwm_gym.tasks import get_task

SINGLE, DOUBLE = get_task("OGBenchCubeSingle"), get_task("OGBenchCubeDouble")


@pytest.fixture(scope="module")
def twin():
    """The single cube's twin, made once."""
    pytest.importorskip("ogbench")
    env = gym.make("pwm/OGBenchCubeSingleSim-v0")
    yield env.unwrapped
    env.close()


@pytest.fixture(scope="module")
def simulator(twin):
    return twin.simulator


def follow(task, simulator, seed, steps=150):
    """Whether the oracle solves the episode of a seed."""
    simulator.reset(seed)
    expert = task.expert(np.random.default_rng(1))
    return any(simulator.step(expert.act(simulator.poses(), simulator.goal())).success for _ in range(steps))


def test_the_oracle_solves_episodes_from_anywhere(simulator):
    assert all(follow(SINGLE, simulator, seed) for seed in seed_range("validation", 2))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "starts"), [(SINGLE, "random"), (SINGLE, "tasks"), (DOUBLE, "random"), (DOUBLE, "tasks")]
)
def test_the_oracle_solves_95_of_100_episodes(task, starts):
    simulator = task.make_simulator(starts=starts)
    assert sum(follow(task, simulator, seed, 300) for seed in seed_range("test", 100)) >= 95
    simulator.close()


def test_the_cost_is_minus_the_simulators_dense_reward(twin):
    rewards, costs, grasps = [], [], []
    twin.reset(seed=3)
    expert = SINGLE.expert(np.random.default_rng(0))
    for _ in range(45):
        scene = twin.scene()
        _, reward, _, _, info = twin.step(expert.act(scene.poses[0], scene.goal))
        rewards.append(info["simulator_reward"])
        costs.append(-reward)
        grasps.append(info["grasped"] == info["simulator_grasped"])
    rewards, costs = np.array(rewards), np.array(costs)
    assert rewards.min() >= 0.0 and 0.4 < rewards.max() <= 1.0
    assert np.median(np.abs(rewards + costs)) < 2e-3
    assert np.corrcoef(rewards, -costs)[0, 1] > 0.98
    assert np.mean(grasps) >= 0.95


def _after(simulator, action):
    simulator.step(action)
    return simulator.poses()


def test_a_scene_of_an_episode_has_the_same_future(twin):
    """From where the oracle lifts the cube; the same seed gives the same way there."""
    expert = SINGLE.expert(np.random.default_rng(0))
    actions = np.random.default_rng(2).uniform(-0.5, 0.5, (5, 5)).astype(np.float32) - [0, 0, 0, 0, 0.5]

    def lifted():
        twin.reset(seed=5)
        held = 0
        while held < 8:
            scene = twin.scene(truth=True)
            held += twin.step(expert.act(scene.poses[0], scene.goal))[-1]["simulator_grasped"]
        return twin.scene(truth=True)

    scene = lifted()
    wanted = [_after(twin.simulator, a) for a in actions]
    np.testing.assert_array_equal(lifted().poses, scene.poses)
    found = []
    for _ in range(2):
        twin.reset(options={"scene": scene})
        np.testing.assert_allclose(twin.simulator.poses(), scene.poses[0], atol=1e-6)
        np.testing.assert_array_equal(twin.simulator.goal(), scene.goal)
        found.append([_after(twin.simulator, a) for a in actions])
    np.testing.assert_allclose(found[0], wanted, atol=2e-4)
    np.testing.assert_array_equal(*found)


def test_evaluation_tasks_are_ogbenchs_own(simulator, monkeypatch):
    """Of seed s task 1 + s modulo 5: its goal, and its start by a centimetre."""
    infos = simulator.world.env.task_infos
    for starts, seed, number in [("tasks", 0, 0), ("tasks", 4, 4), ("tasks", 8, 3), ("task3", 7, 2)]:
        monkeypatch.setattr(simulator.world, "_starts", starts)
        simulator.reset(seed)
        info = infos[number]
        np.testing.assert_allclose(simulator.goal(), info["goal_xyzs"][0], atol=1e-6)
        off = simulator.pose("cube")[:3] - info["init_xyzs"][0]
        assert 0.0 < np.abs(off[:2]).max() <= 0.01 and abs(off[2]) < 1e-3


def test_unknown_starts_are_refused():
    with pytest.raises(UnknownNameError, match=r"unknown starts of OGBenchCubeSingle 'task'; known: .*Did you mean"):
        SINGLE.make_simulator(starts="task")
    with pytest.raises(UnknownNameError, match="unknown starts 'task'"):
        CubeWorld(1, starts="task")
    with pytest.raises(UnknownNameError, match="unknown starts of PickCube 'tasks'; known: none"):
        get_task("PickCube").make_simulator(starts="tasks")


@pytest.mark.parametrize("task", [SINGLE, DOUBLE], ids=lambda t: t.name)
def test_without_ogbench_the_error_says_what_to_install(task, monkeypatch):
    monkeypatch.setattr("pwm_gym.sim.mujoco.ogbench._FREE", {})
    for name in ("ogbench", "ogbench.manipspace.envs.cube_env", "ogbench.manipspace.oracles.markov.cube_markov"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(PwmGymError, match=r"pip install 'pwm-gym\[ogbench\]'"):
        task.make_simulator()
    poses, goal = np.tile([0.4, 0, 0.2, 0, 1, 0, 0], (len(task.layout), 1)), np.zeros(task.goal_size)
    with pytest.raises(PwmGymError, match=r"pip install 'pwm-gym\[ogbench\]'"):
        task.expert(np.random.default_rng(0)).act(poses, goal)


def test_the_fingers_swing_as_the_robot_says(simulator):
    from pwm_gym.robots import Channel
    from pwm_gym.sim.mujoco import robot_of

    channels = [Channel("translation", 0, 3), Channel("yaw", 3, 4), Channel("gripper", 4, 5)]
    for name, joint in robot_of(simulator, "ur5e", channels).joints.items():
        told = UR5E.joints[name]
        assert (told.kind, told.parent) == (joint.kind, joint.parent)
        for field in ("origin", "axis", "lower", "upper"):
            np.testing.assert_allclose(getattr(told, field), getattr(joint, field), atol=1e-9)
    simulator.reset(0)
    tree = JointTree(SINGLE.layout, [1, 2, 3, 4])
    for gripper in (-1.0, 1.0):
        for _ in range(12):
            simulator.step(np.array([0.0, 0.0, 0.2, 0.0, gripper], np.float32))
        poses = simulator.poses()
        frames = matrix_from_pose7(torch.as_tensor(poses)).float()
        np.testing.assert_allclose(tree.place(frames, tree.positions(frames)), frames, atol=1e-5)
        assert opening(poses) == pytest.approx(ROBOTIQ.opening if gripper > 0 else 0.0, abs=2e-3)


def test_tool_and_clouds_are_where_the_environment_measures_the_tool(twin):
    twin.reset(seed=1)
    tool = tool_pose(twin.simulator.poses())
    site = twin.simulator.data.site("ur5e/robotiq/pinch")
    np.testing.assert_allclose(tool[:3], site.xpos, atol=1e-6)
    np.testing.assert_allclose(matrix_from_pose7(torch.as_tensor(tool))[:3, :3], site.xmat.reshape(3, 3), atol=1e-6)
    points, _ = cost_info(twin.state, torch.zeros(1, 5), twin.goal, twin.rules.grasp)
    np.testing.assert_allclose(contacts.tool_centre(points, ROBOTIQ)[0], tool[:3], atol=2e-3)
    assert float(contacts.opening(points, ROBOTIQ)) == pytest.approx(ROBOTIQ.opening, abs=3e-3)


def test_the_arms_chain_puts_the_hand_where_the_simulator_does(simulator):
    kinematics = ArmKinematics(UR5E.control.arms[0].chain)
    for seed in range(3):
        simulator.reset(seed)
        hand = kinematics(torch.as_tensor(simulator.joints()[:1, :6]))[0].numpy()
        np.testing.assert_allclose(hand, matrix_from_pose7(torch.as_tensor(simulator.poses()[0])), atol=2e-6)


def test_targets_are_where_the_environment_drives_the_tool(simulator):
    """Near the table's edge and down to it, too."""
    kinematics = ArmKinematics(UR5E.control.arms[0].chain)
    rng = np.random.default_rng(0)
    for seed in range(4):
        simulator.reset(seed)
        for action in rng.uniform(-1, 1, (3, 5)).astype(np.float32) - [0, 0, 0.5, 0, 0]:
            hand = matrix_from_pose7(torch.as_tensor(simulator.poses()[0]))
            simulator.step(np.clip(action, -1, 1))
            action = torch.as_tensor(np.clip(action, -1, 1))
            wanted = kinematics.target(hand, 0.05 * action[:3], yaw=0.3 * action[3:4]) @ kinematics.grip.double()
            told = simulator.world.env._target_effector_pose.as_matrix()
            np.testing.assert_allclose(wanted, told, atol=2e-6)


def test_a_unit_of_yaw_turns_the_tool_about_the_vertical(simulator):
    simulator.reset(2)
    before = tool_pose(simulator.poses())
    for _ in range(4):
        simulator.step(np.array([0.0, 0.0, 0.0, 0.5, 1.0], np.float32))
    after = tool_pose(simulator.poses())
    turn = [np.arctan2(*matrix_from_pose7(torch.as_tensor(p))[:2, 0].flip(0).numpy()) for p in (before, after)]
    way = (turn[1] - turn[0] + np.pi) % (2 * np.pi) - np.pi
    assert 0.1 < way < 0.6


def test_the_lower_cube_comes_first_and_a_cube_that_is_there_counts():
    several = Several(("a", "b"), 0.04)
    places = {"a": torch.tensor([[[0.4, 0.0, 0.02]], [[0.4, 0.0, 0.02]]]), "b": torch.tensor([[[0.5, 0.2, 0.02]]] * 2)}
    stacked = torch.tensor([[0.3, 0.1, 0.06, 0.3, 0.1, 0.02], [0.4, 0.01, 0.02, 0.3, 0.1, 0.06]])
    info = {"goal": stacked}
    named = several.of_next(lambda name: lambda points, info: torch.full((2,), float(name == "b")))
    assert named(places, info).tolist() == [1.0, 1.0]  # its goal is below the other's; the other one is there
    assert several.left(places, info).tolist() == [2.0, 1.0]
    assert several.all_there(places, info).tolist() == [False, False]


def test_play_starts_in_motion_with_the_cubes_place_25_steps_later_as_goal(twin, monkeypatch):
    """And with the poses and the action before it; the scene has the same future in a restored twin."""
    simulator, seed, seen = twin.simulator, seed_range("plan_test", 1, 2)[0], []
    monkeypatch.setattr(simulator.world, "_starts", "play")
    step = ogbench_play._Player.step

    def watched(player):
        action = step(player)
        seen.append((simulator.data.joint("object_joint_0").qpos.copy(), action))
        return action

    monkeypatch.setattr(ogbench_play._Player, "step", watched)
    twin.reset(seed=seed)
    scene = twin.scene(truth=True)
    np.testing.assert_allclose(scene.goal, seen[-1][0][:3], atol=1e-6)
    np.testing.assert_allclose(scene.poses[:, -1, :3], [cube[:3] for cube, _ in seen[-26:-29:-1]], atol=1e-6)
    np.testing.assert_array_equal(simulator.poses(), scene.poses[0])
    assert np.abs(scene.poses[0] - scene.poses[1]).max() > 1e-3
    np.testing.assert_allclose(scene.last_action, seen[-26][1] * [1, 1, 1, 1, -1], atol=1e-6)

    action = np.array([0.1, 0.2, -0.1, 0.3, -0.5], np.float32)
    wanted = _after(simulator, action)
    twin.reset(seed=seed)
    np.testing.assert_array_equal(twin.scene(truth=True).poses, scene.poses)
    np.testing.assert_array_equal(twin.scene(truth=True).goal, scene.goal)
    twin.reset(options={"scene": scene})
    found = _after(simulator, action)
    np.testing.assert_allclose(found[:, :3], wanted[:, :3], atol=5e-4)
    np.testing.assert_allclose(found[:, 3:], wanted[:, 3:], atol=1e-2)  # what is held turns a little within a step
    assert len(seen) < 2 * (ogbench_play.LENGTH + 1)


def test_play_that_has_not_begun_has_no_past(simulator, monkeypatch):
    monkeypatch.setattr(simulator.world, "_starts", "play")
    monkeypatch.setattr(ogbench_play, "AHEAD", 1)
    monkeypatch.setattr(ogbench_play, "LENGTH", 2)
    simulator.reset(3)
    assert simulator.past() is None and simulator.world.play.action is None
    assert np.linalg.norm(simulator.goal() - simulator.pose("cube")[:3]) < 1e-3
    monkeypatch.setattr(simulator.world, "_starts", "tasks")
    simulator.reset(3)
    assert simulator.past() is None


@pytest.mark.slow
def test_the_planners_cost_falls_by_a_move_where_the_oracle_of_a_swap_sets_a_cube_down():
    """One cube aside, the other to its goal, the first one back: what is left never grows."""
    pytest.importorskip("ogbench")
    twin = gym.make("pwm/OGBenchCubeDoubleSim-v0", starts="task4").unwrapped
    twin.reset(seed=seed_range("plan_test", 1)[0])
    expert, cost = DOUBLE.expert(np.random.default_rng(0)), get_cost(DOUBLE.plan_cost)
    left, success = [], False
    for _ in range(220):
        scene = twin.scene()
        action = expert.act(scene.poses[0], scene.goal)
        success = twin.step(action)[-1]["success"]
        points, info = cost_info(twin.state, torch.as_tensor(action)[None], twin.goal, twin.rules.grasp)
        left.append(float(cost.evaluate(points, info)["moves"]))
        if success:
            break
    twin.close()
    steps = [value for value, _ in groupby(left)]
    assert success and len(steps) == 3
    assert steps == pytest.approx([3.0 * steps[-1], 2.0 * steps[-1], steps[-1]])
