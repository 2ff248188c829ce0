from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.errors import PwmGymError, SceneError, UnknownNameError
from pwm_gym.robots.joints import JointTree
from pwm_gym.robots.panda import tool_pose
from pwm_gym.scene import Scene
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sim import PlacesBodies, SimOutcome, Simulator
from pwm_gym.sim.maniskill import ManiSkillSimulator
from pwm_gym.sim.maniskill.headless import allow_headless
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
CUBE = TASK.layout.index("cube")


def trace(simulator, seed, actions):
    """Poses (T + 1, E, 7), joint positions (T + 1, J) and outcomes of an episode."""
    simulator.reset(seed)
    poses, joints, outcomes = [simulator.poses()], [simulator.joints()[0]], []
    for action in actions:
        outcomes.append(simulator.step(action))
        poses.append(simulator.poses())
        joints.append(simulator.joints()[0])
    return np.array(poses), np.array(joints), outcomes


def expert_steps(simulator, seed, count):
    simulator.reset(seed)
    expert = TASK.expert(np.random.default_rng(seed))
    for _ in range(count):
        simulator.step(expert.act(simulator.poses(), simulator.goal()))


def test_is_a_simulator(simulator):
    assert isinstance(simulator, Simulator) and isinstance(simulator, PlacesBodies)
    assert simulator.action_size == TASK.action_size


def test_the_headless_probe_can_be_repeated(simulator):
    import sapien.render

    missing, material = allow_headless(), sapien.render.RenderMaterial
    assert allow_headless() == missing
    assert sapien.render.RenderMaterial is material
    sapien.render.RenderMaterial().set_base_color([1, 1, 1, 1])  # what tasks do while they build


def test_poses_are_in_the_frame_of_the_robots_base(simulator):
    hands, cubes = [], []
    for seed in range(8):
        simulator.reset(seed)
        poses = simulator.poses()
        np.testing.assert_allclose(np.linalg.norm(poses[:, 3:], axis=1), 1, atol=1e-6)
        hands.append(poses[0, :3])
        cubes.append(poses[CUBE, :3])
    np.testing.assert_allclose(np.mean(hands, 0), [0.615, 0.0, 0.28], atol=0.02)
    cubes = np.array(cubes)
    np.testing.assert_allclose(cubes[:, 2], 0.02, atol=1e-3)  # on the table, which is at the base's height
    assert (np.abs(cubes[:, :2] - [0.615, 0.0]) < 0.101).all()  # ManiSkill spawns it within 10 cm of its origin


def test_positions_differ_from_the_simulators_world_by_the_bases_place(simulator):
    simulator.reset(3)
    world = simulator.env.unwrapped.scene.actors["cube"].pose.p[0].numpy()
    np.testing.assert_allclose(simulator.poses()[CUBE, :3] - world, [0.615, 0, 0], atol=1e-6)
    goal = simulator.env.unwrapped.goal_site.pose.p[0].numpy()
    np.testing.assert_allclose(simulator.goal() - goal, [0.615, 0, 0], atol=1e-6)


def test_fingers_slide_on_the_hand_as_the_tasks_sliders_say(simulator, random_actions):
    poses, joints, _ = trace(simulator, 0, random_actions(0, 40, TASK.action_size))
    frames = matrix_from_pose7(torch.as_tensor(poses)).float()  # (T, E, 4, 4)
    fingers = JointTree(TASK.layout, [1, 2])
    np.testing.assert_allclose(fingers.positions(frames), joints[:, 7:], atol=1e-4)
    placed = fingers.place(frames, torch.as_tensor(joints[:, 7:]))
    torch.testing.assert_close(placed[..., :3, 3], frames[..., :3, 3], atol=1e-4, rtol=0)
    torch.testing.assert_close(placed[..., :3, :3], frames[..., :3, :3], atol=1e-3, rtol=0)
    assert joints[:, 7].std() > 1e-3


def test_meshes_are_in_their_entities_frames(simulator):
    meshes = simulator.meshes()
    assert set(meshes) == set(TASK.layout.names)
    np.testing.assert_allclose(meshes["cube"].bounds, [[-0.02] * 3, [0.02] * 3], atol=1e-6)
    simulator.reset(1)
    poses = matrix_from_pose7(torch.as_tensor(simulator.poses())).numpy()
    lowest = {n: meshes[n].copy().apply_transform(poses[i]).bounds[0, 2] for i, n in enumerate(TASK.layout.names)}
    assert lowest["cube"] == pytest.approx(0.0, abs=1e-3)  # it stands on the table
    tips = min(lowest["left_gripper"], lowest["right_gripper"])
    assert 0 < tool_pose(simulator.poses())[2] - tips < 0.015  # the tool centre is just above the finger tips
    assert meshes["left_gripper"].bounds[:, 1] == pytest.approx([0, 0.026], abs=1e-3)  # its pad looks inwards


def test_an_outcome_is_of_the_step_just_made(simulator, random_actions):
    simulator.reset(0)
    outcome = simulator.step(random_actions(1, TASK.action_size))
    assert isinstance(outcome, SimOutcome)
    assert (type(outcome.reward), type(outcome.success), type(outcome.grasped)) == (float, bool, bool)
    assert 0 < outcome.reward < 1 and not outcome.success and not outcome.grasped
    again = simulator.outcome()
    assert again.reward == pytest.approx(outcome.reward)
    assert (again.success, again.grasped) == (outcome.success, outcome.grasped)


def test_the_seed_decides_the_episode(simulator, random_actions):
    actions = random_actions(2, 15, TASK.action_size)
    poses, joints, outcomes = trace(simulator, 7, actions)
    expert_steps(simulator, 8, 40)  # whatever happened before
    again, joints_again, outcomes_again = trace(simulator, 7, actions)
    np.testing.assert_array_equal(again, poses)
    np.testing.assert_array_equal(joints_again, joints)
    assert outcomes_again == outcomes
    assert not np.allclose(trace(simulator, 9, [])[0][0, CUBE], poses[0, CUBE])


def scene_of(simulator, previous):
    return Scene(
        task="PickCube",
        layout=TASK.layout,
        clouds=np.zeros((TASK.layout.points, 3), np.float32),
        poses=np.stack([simulator.poses(), previous, previous]),
        goal=simulator.goal(),
        joints=simulator.joints(),
    )


def test_an_episode_goes_on_from_a_restored_scene(simulator):
    expert_steps(simulator, 4, 20)
    before = simulator.poses()
    simulator.step(np.zeros(7))
    scene = scene_of(simulator, before)
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (10, 7))
    truth = [(simulator.step(a).reward, simulator.poses())[1] for a in actions]

    expert_steps(simulator, 5, 10)
    simulator.restore(scene)
    np.testing.assert_allclose(simulator.poses()[CUBE], scene.poses[0, CUBE], atol=1e-5)
    np.testing.assert_allclose(simulator.goal(), scene.goal, atol=1e-6)
    np.testing.assert_array_equal(simulator.joints()[0], scene.joints[0])
    replayed = [(simulator.step(a), simulator.poses())[1] for a in actions]
    gap = np.linalg.norm(np.array(truth) - replayed, axis=-1)
    assert gap[..., 0].max() < 0.01 and np.abs(np.array(truth)[..., :3] - np.array(replayed)[..., :3]).max() < 0.01


def test_a_restored_cube_keeps_the_velocity_that_its_poses_tell(simulator):
    simulator.reset(4)
    scene = scene_of(simulator, simulator.poses())
    poses = scene.poses.copy()
    poses[:, CUBE, :3] = [0.3, 0.5, 0.4]  # in free fall beside the arm
    poses[1:, CUBE, 1] -= 0.02  # 2 cm a step towards +y
    simulator.restore(replace(scene, poses=poses))
    start = simulator.poses()[CUBE]
    simulator.step(np.zeros(7))
    moved = simulator.poses()[CUBE] - start
    assert moved[1] == pytest.approx(0.02, abs=1e-3)
    assert moved[2] == pytest.approx(-9.81 * 0.01**2 * (1 + 2 + 3 + 4 + 5), abs=1e-4)  # five substeps of 10 ms


def test_a_scene_without_joints_cannot_start_a_simulator(simulator):
    simulator.reset(0)
    with pytest.raises(SceneError, match=r"scene\.joints is None"):
        simulator.restore(replace(scene_of(simulator, simulator.poses()), joints=None))


def test_a_scene_of_another_robot_cannot_start_a_simulator(simulator):
    simulator.reset(0)
    scene = scene_of(simulator, simulator.poses())
    with pytest.raises(SceneError, match=r"scene\.joints has 7 joints; the simulator's robot has 9"):
        simulator.restore(replace(scene, joints=scene.joints[:, :7]))


def test_joint_velocities_are_those_of_a_step(simulator):
    expert_steps(simulator, 4, 20)
    before = simulator.joints()
    np.testing.assert_array_equal(before.shape, (2, 9))
    simulator.step(np.zeros(7))
    moved = simulator.joints()[0] - before[0]
    fastest = np.abs(before[1, :7]).argmax()
    assert 0.2 < moved[fastest] / before[1, fastest] < 1.0  # it brakes
    scene = scene_of(simulator, simulator.poses())
    simulator.reset(5)
    simulator.restore(scene)
    np.testing.assert_allclose(simulator.joints(), scene.joints, atol=1e-6)


def test_closing_twice_is_harmless():
    simulator = TASK.simulator()
    simulator.close()
    simulator.close()


def test_contacts_too_do_not_depend_on_earlier_episodes(simulator):
    """PhysX keeps the order of contacts, so that one scene for all episodes ends millimetres apart."""

    def grasp(seed):
        simulator.reset(seed)
        expert = TASK.expert(np.random.default_rng([seed, 0]))
        return np.array([(simulator.step(expert.act(simulator.poses(), simulator.goal())), simulator.poses())[1]
                         for _ in range(32)])  # fmt: skip

    truth = grasp(200_000)
    for seed in (33_333, 233_333):
        wander = np.random.default_rng(seed)
        simulator.reset(seed)
        for _ in range(40):
            target = simulator.poses()[CUBE, :3] - tool_pose(simulator.poses())[:3]
            simulator.step(np.r_[np.clip(10 * target, -1, 1), wander.uniform(-1, 1, 4)])
        np.testing.assert_array_equal(grasp(200_000), truth)


def test_a_placed_body_is_at_rest_and_then_falls(simulator):
    simulator.reset(2)
    pose = np.array([0.5, 0.3, 0.4, *[0.5**0.5, 0, 0, 0.5**0.5]])
    simulator.place("cube", pose)
    np.testing.assert_allclose(simulator.poses()[CUBE], pose, atol=1e-6)
    heights = [0.4]
    for _ in range(3):
        simulator.step(np.zeros(7))
        heights.append(simulator.poses()[CUBE, 2])
    falls = -9.81 * 0.01**2 * np.array([15, 40, 65])  # five substeps of 10 ms each
    np.testing.assert_allclose(np.diff(heights), falls, atol=2e-4)


def test_only_free_bodies_can_be_placed(simulator):
    with pytest.raises(SceneError, match="'hand' is a link of the robot"):
        simulator.place("hand", simulator.poses()[0])
    with pytest.raises(UnknownNameError, match="unknown entity 'cub'.*Did you mean 'cube'"):
        simulator.place("cub", simulator.poses()[CUBE])


def test_a_task_without_a_goal_is_restored_too(stack_simulator):
    stack = get_task("StackCube")
    stack_simulator.reset(1)
    for _ in range(5):
        stack_simulator.step(np.array([0.2, 0, -0.5, 0, 0, 0, 1.0]))
    poses, joints = stack_simulator.poses(), stack_simulator.joints()
    clouds = np.zeros((stack.layout.points, 3), np.float32)
    scene = Scene("StackCube", stack.layout, clouds, np.stack([poses] * 3), stack_simulator.goal(), joints)
    stack_simulator.reset(2)
    assert not np.allclose(stack_simulator.poses()[3:], poses[3:], atol=1e-3)
    stack_simulator.restore(scene)
    np.testing.assert_allclose(stack_simulator.poses(), poses, atol=1e-4)
    np.testing.assert_allclose(stack_simulator.joints(), joints, atol=1e-6)


def test_a_scene_of_other_entities_is_refused(stack_simulator, simulator):
    simulator.reset(0)
    with pytest.raises(SceneError, match=r"entities are \('hand', .*'cube'\); expected .*'cube_b'"):
        stack_simulator.restore(scene_of(simulator, simulator.poses()))


def test_assets_are_the_entities_own_where_they_never_differ(simulator):
    assert simulator.assets() == TASK.layout.names


class Tinted:
    """An asset choice that notes what it is asked for; ``env.chosen`` is the present asset of cube B."""

    def __init__(self):
        self.forced = []

    def force(self, env, assets):
        self.forced.append(assets)
        env.chosen = assets["cube_b"] if assets else f"asset{len(self.forced)}"

    def names(self, env):
        return {"cube_b": env.chosen}


@pytest.fixture(scope="module")
def tinted():
    """StackCube's with assets, an entity told by a function and grasps told by the robot."""
    stack = get_task("StackCube")
    bodies = {**stack.robot.links, "cube_a": lambda env: env.cubeA, "cube_b": "cubeB"}
    choice = Tinted()
    simulator = ManiSkillSimulator("StackCube-v1", bodies, robot_uids="panda", grasped="cube_a", assets=choice)
    yield simulator, choice
    simulator.close()


def test_the_seed_chooses_assets_and_a_scene_forces_them(tinted):
    simulator, choice = tinted
    stack = get_task("StackCube")
    simulator.reset(0)
    assert choice.forced[-1] is None
    own = simulator.assets()
    assert own[:4] == stack.layout.names[:4] and own[4].startswith("asset")
    clouds = np.zeros((stack.layout.points, 3), np.float32)
    poses = np.stack([simulator.poses()] * 3)
    scene = Scene("StackCube", stack.layout, clouds, poses, simulator.goal(), simulator.joints())
    simulator.restore(scene)  # a scene that names none keeps the episode's
    assert simulator.assets() == own
    other = (*stack.layout.names[:4], "other")
    simulator.restore(replace(scene, assets=other), rebuild=False)  # which it has to, nevertheless
    assert choice.forced[-1]["cube_b"] == "other" and simulator.assets() == other
    np.testing.assert_allclose(simulator.poses(), poses[0], atol=1e-4)


def test_a_grasp_can_be_told_by_the_robot(tinted):
    simulator, _ = tinted
    stack = get_task("StackCube")
    simulator.reset(0)
    expert = stack.expert(np.random.default_rng(0))
    outcomes = []
    for _ in range(70):
        outcomes.append(simulator.step(expert.act(simulator.poses(), simulator.goal())))
        key = bool(simulator.env.unwrapped.evaluate()["is_cubeA_grasped"])
        assert outcomes[-1].grasped == key
    assert outcomes[-1].grasped and not outcomes[0].grasped


def test_what_a_task_lacks_is_named():
    links = {"hand": "panda_hand"}
    with pytest.raises(UnknownNameError, match="unknown body of PickCube-v1 'cub'.*Did you mean 'cube'"):
        ManiSkillSimulator("PickCube-v1", {**links, "cube": "cub"}).close()


def test_a_control_of_another_period_or_size_is_refused():
    control = TASK.control
    with pytest.raises(PwmGymError, match=r"control period of 0\.0500 s; expected 0\.1000 s"):
        ManiSkillSimulator("PickCube-v1", {"cube": "cube"}, control=replace(control, period=0.1))
    with pytest.raises(PwmGymError, match="actions of 8 components; expected 7"):
        ManiSkillSimulator("PickCube-v1", {"cube": "cube"}, control_mode="pd_joint_delta_pos", control=control)
