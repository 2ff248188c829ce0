import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pwm_gym.seeds import seed_range
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
LIMIT = 120


def steps_to_success(simulator, seed):
    """Expert's steps until the simulator calls it a success; LIMIT + 1 if it never does."""
    simulator.reset(seed)
    expert = TASK.expert(np.random.default_rng(seed))
    for step in range(1, LIMIT + 1):
        if simulator.step(expert.act(simulator.poses(), simulator.goal())).success:
            return step
    return LIMIT + 1


def check(steps, least, mean):
    steps = np.array(steps)
    assert (steps <= LIMIT).mean() >= least, steps
    assert mean[0] <= steps[steps <= LIMIT].mean() <= mean[1], steps


def test_the_expert_picks_the_cube(simulator):
    check([steps_to_success(simulator, s) for s in seed_range("validation", 6)], 1.0, (45, 95))


@pytest.mark.slow
def test_the_expert_picks_the_cube_in_nearly_every_of_40_episodes(simulator):
    check([steps_to_success(simulator, s) for s in seed_range("test", 40)], 0.95, (60, 80))


def test_the_expert_goes_on_from_wherever_the_scene_is(simulator):
    simulator.reset(11)
    expert = TASK.expert(np.random.default_rng(0))
    for _ in range(40):  # half way, and then pushed about
        simulator.step(expert.act(simulator.poses(), simulator.goal()))
    for _ in range(5):
        simulator.step(np.array([0, 0, 1, 0, 0, 0, 1], np.float32))
    other = TASK.expert(np.random.default_rng(1))
    assert any(simulator.step(other.act(simulator.poses(), simulator.goal())).success for _ in range(LIMIT))


def test_experts_differ_and_their_actions_are_actions(simulator):
    simulator.reset(0)
    poses, goal = simulator.poses(), simulator.goal()
    rng = np.random.default_rng(0)
    actions = np.array([TASK.expert(rng).act(poses, goal) for _ in range(5)])
    assert actions.shape == (5, 7) and actions.dtype == np.float32
    assert np.abs(actions).max() <= 1
    assert len(np.unique(actions.round(5), axis=0)) == 5


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("part", ["translation", "rotation"])
def test_an_action_moves_the_tool_along_its_axis_of_the_bases_frame(simulator, part, axis):
    simulator.reset(0)
    translation, rotation = np.zeros(3), np.zeros(3)
    (translation if part == "translation" else rotation)[axis] = 0.03
    before = TASK.robot.tool(simulator.poses())
    for _ in range(4):
        simulator.step(TASK.robot.action(translation, rotation, 1.0))
    after = TASK.robot.tool(simulator.poses())
    turn = Rotation.from_quat(after[3:], scalar_first=True) * Rotation.from_quat(before[3:], scalar_first=True).inv()
    moved = after[:3] - before[:3] if part == "translation" else turn.as_rotvec()
    assert moved[axis] > 0.02
    assert moved[axis] > 3 * np.abs(np.delete(moved, axis)).max()


def test_the_gripper_opens_at_1_and_shuts_at_minus_1(simulator):
    simulator.reset(0)
    for command, opening in ((-1.0, 0.0), (1.0, 0.08)):
        for _ in range(12):
            simulator.step(TASK.robot.action(np.zeros(3), np.zeros(3), command))
        assert simulator.joints()[0, 7:].sum() == pytest.approx(opening, abs=0.002)


def test_actions_beyond_the_limits_are_clipped():
    action = TASK.robot.action(np.array([1.0, -1.0, 0.05]), np.zeros(3), -3.0)
    np.testing.assert_allclose(action, [1, -1, 0.5, 0, 0, 0, -1])
