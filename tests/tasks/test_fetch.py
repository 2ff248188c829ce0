"""The Fetch tasks in their simulator: experts, rewards, restoring, the robot's description."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from pwm_gym.costs import contacts, cost_info
from pwm_gym.errors import SceneError
from pwm_gym.robots.fetch import FETCH, TABLE, WIDE_TABLE, opening
from pwm_gym.robots.gripper import FETCH as GRIPPER
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.seeds import seed_range
from pwm_gym.tasks import get_task

NAMES = ("FetchReach", "FetchPush", "FetchSlide", "FetchPickAndPlace")
EXPERTS = {"FetchReach": (4, 4), "FetchPush": (4, 4), "FetchSlide": (6, 2), "FetchPickAndPlace": (4, 4)}
LIMIT = 50


@pytest.fixture(scope="module")
def simulators():
    """Each task's simulator, made once."""
    made = {}

    def get(name):
        if name not in made:
            made[name] = get_task(name).make_simulator()
        return made[name]

    yield get
    for simulator in made.values():
        simulator.close()


@pytest.fixture(scope="module")
def twins():
    """Each task's twin, made once."""
    made = {}

    def get(name):
        if name not in made:
            made[name] = gym.make(f"pwm/{name}Sim-v0")
        return made[name]

    yield get
    for twin in made.values():
        twin.close()


def follow(name, simulator, seed, steps=LIMIT):
    """Success at any step and at the last one of an expert's episode."""
    simulator.reset(seed)
    expert = get_task(name).expert(np.random.default_rng(seed))
    found = [simulator.step(expert.act(simulator.poses(), simulator.goal())).success for _ in range(steps)]
    return any(found), found[-1]


@pytest.mark.parametrize("name", NAMES)
def test_the_expert_solves_its_task(simulators, name):
    count, least = EXPERTS[name]
    found = [follow(name, simulators(name), seed) for seed in seed_range("validation", count)]
    assert sum(any_step for any_step, _ in found) >= least, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "least"), [("FetchReach", 95), ("FetchPush", 95), ("FetchSlide", 55), ("FetchPickAndPlace", 95)]
)
def test_the_expert_solves_its_task_in_as_many_of_100_episodes(simulators, name, least):
    found = [follow(name, simulators(name), seed) for seed in seed_range("test", 100)]
    assert sum(last for _, last in found) >= least


@pytest.mark.parametrize("name", NAMES)
def test_the_cost_is_minus_the_simulators_dense_reward(twins, name):
    twin, task = twins(name), get_task(name)
    rewards, costs, grasps = [], [], []
    twin.reset(seed=3)
    expert = task.expert(np.random.default_rng(0))
    for _ in range(30):
        scene = twin.unwrapped.scene()
        _, reward, _, _, info = twin.unwrapped.step(expert.act(scene.poses[0], scene.goal))
        rewards.append(info["simulator_reward"])
        costs.append(-reward)
        grasps.append(info["grasped"] == info["simulator_grasped"])
    rewards, costs = np.array(rewards), np.array(costs)
    assert 0.0 <= rewards.min() < 0.95 and rewards.max() <= 1.0
    assert np.median(np.abs(rewards + costs)) < 2e-3
    assert np.corrcoef(rewards, -costs)[0, 1] > 0.98
    assert np.mean(grasps) >= 0.95


@pytest.mark.parametrize("name", ["FetchReach", "FetchPickAndPlace"])
def test_the_twin_passes_gymnasiums_checks(twins, name):
    check_env(twins(name).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_episode_bit_for_bit(simulators, name):
    simulator = simulators(name)
    actions = np.random.default_rng(0).uniform(-1, 1, (6, 4)).astype(np.float32)

    def episode():
        simulator.reset(7)
        return np.array([simulator.poses(), *[_after(simulator, a) for a in actions]]), simulator.goal()

    poses, goal = episode()
    simulator.reset(8)
    again, same = episode()
    np.testing.assert_array_equal(poses, again)
    np.testing.assert_array_equal(goal, same)


def _after(simulator, action):
    simulator.step(action)
    return simulator.poses()


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_of_an_episode_has_the_same_future(twins, name):
    """From the middle of the expert's way, as another simulator has it."""
    twin, task = twins(name), get_task(name)
    twin.reset(seed=5)
    expert = task.expert(np.random.default_rng(1))
    for _ in range(7):
        scene = twin.unwrapped.scene()
        twin.unwrapped.step(expert.act(scene.poses[0], scene.goal))
    scene = twin.unwrapped.scene(truth=True)
    actions = np.random.default_rng(2).uniform(-0.5, 0.5, (6, 4)).astype(np.float32)
    wanted = [_after(twin.unwrapped.simulator, a) for a in actions]
    other = task.make_simulator()
    other.restore(scene)
    np.testing.assert_allclose(other.poses(), scene.poses[0], atol=1e-6)
    np.testing.assert_array_equal(other.goal(), scene.goal)
    found = [_after(other, a) for a in actions]
    np.testing.assert_allclose(found, wanted, atol=2e-5)
    other.restore(scene)
    np.testing.assert_array_equal([_after(other, a) for a in actions], found)


def test_a_scene_of_another_robot_is_refused(twins):
    twin = twins("FetchReach")
    twin.reset(seed=0)
    scene = twin.unwrapped.scene()
    twin.unwrapped.step(np.zeros(4, np.float32))
    scene = replace(twin.unwrapped.scene(), joints=np.zeros((2, 9), np.float32))
    with pytest.raises(SceneError, match="has 9 joints; the simulator's robot has 15"):
        twin.reset(options={"scene": scene})


def test_the_fingers_slide_on_the_hand_as_the_robot_says(simulators):
    simulator, task = simulators("FetchPickAndPlace"), get_task("FetchPickAndPlace")
    simulator.reset(0)
    tree = JointTree(task.layout, [1, 2])
    for gripper in (1.0, -1.0):
        for _ in range(12):
            simulator.step(np.array([0.1, 0.0, 0.0, gripper], np.float32))
        poses = torch.as_tensor(simulator.poses())
        frames = matrix_from_pose7(poses).float()
        positions = tree.positions(frames)
        np.testing.assert_allclose(positions, simulator.joints()[0, [-1, -2]], atol=1e-5)
        np.testing.assert_allclose(tree.place(frames, positions), frames, atol=1e-5)
        assert positions[0] == pytest.approx(float(positions[1]), abs=2e-3)  # they move together
        assert opening(poses.numpy()) == pytest.approx(GRIPPER.opening if gripper > 0 else 0.0018, abs=2e-3)


def test_the_tool_is_where_the_environment_measures_it(simulators):
    simulator = simulators("FetchReach")
    simulator.reset(1)
    tool = FETCH.tool(simulator.poses())
    base = simulator.data.body("robot0:base_link").xpos * [1, 1, 0] + [0, 0, 0.4]
    np.testing.assert_allclose(tool[:3], simulator.data.site("robot0:grip").xpos - base, atol=1e-6)
    rotation = matrix_from_pose7(torch.as_tensor(tool))[:3, :3]
    np.testing.assert_allclose(rotation[:, 2], [0, 0, -1], atol=0.01)  # it points down
    np.testing.assert_allclose(rotation[:, 1], [0, 1, 0], atol=0.01)


def test_clouds_tell_the_tool_centre(twins):
    twin = twins("FetchPickAndPlace").unwrapped
    twin.reset(seed=0)
    points, _ = cost_info(twin.state, torch.zeros(1, 4), twin.goal, twin.rules.grasp)
    tool = FETCH.tool(twin.scene().poses[0])[:3]
    np.testing.assert_allclose(contacts.tool_centre(points, GRIPPER)[0], tool, atol=2e-3)
    assert float(contacts.opening(points, GRIPPER)) == pytest.approx(0.0018, abs=2e-3)


@pytest.mark.parametrize(("name", "table"), [("FetchPush", TABLE), ("FetchSlide", WIDE_TABLE)])
def test_the_tables_top_is_at_height_zero(simulators, name, table):
    simulator = simulators(name)
    simulator.reset(0)
    for _ in range(3):
        simulator.step(np.array([0, 0, 1, 0], np.float32))
    object_ = simulator.meshes()["object"]
    assert simulator.poses()[-1, 2] + object_.bounds[0, 2] == pytest.approx(0.0, abs=1e-3)
    body = simulator.data.body("table0")
    place = body.xpos - simulator.data.body("robot0:base_link").xpos - [0, 0, 0.4]
    np.testing.assert_allclose(table.origin[:3], place, atol=1e-4)
    geom = simulator.model.body("table0").geomadr[0]
    np.testing.assert_allclose(table.half, simulator.model.geom_size[geom])


def test_an_ordinary_camera_sees_the_object():
    twin = gym.make("pwm/FetchPushSim-v0", observation="partial")
    observation, _ = twin.reset(seed=0)
    task = get_task("FetchPush")
    seen = observation["points"][task.layout["object"].slice]
    pose = twin.unwrapped.scene(truth=True).poses[0][-1]
    assert np.linalg.norm(seen - pose[:3], axis=1).max() < 0.05
    twin.close()
