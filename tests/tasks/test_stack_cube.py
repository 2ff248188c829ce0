import numpy as np
import pytest

from pwm_gym.seeds import seed_range
from pwm_gym.tasks import get_task

TASK = get_task("StackCube")
A, B = TASK.layout.index("cube_a"), TASK.layout.index("cube_b")
LIMIT = 180


def run(simulator, seed, steps=LIMIT):
    """Expert's steps until the simulator calls it a success; ``steps`` + 1 if it never does."""
    simulator.reset(seed)
    expert = TASK.expert(np.random.default_rng(seed))
    for step in range(1, steps + 1):
        if simulator.step(expert.act(simulator.poses(), simulator.goal())).success:
            return step
    return steps + 1


def test_the_expert_stacks_the_cubes(stack_simulator):
    steps = np.array([run(stack_simulator, seed) for seed in seed_range("validation", 2)])
    assert (steps <= LIMIT).all() and 50 < steps.mean() < 150, steps


@pytest.mark.slow
def test_the_expert_stacks_the_cubes_in_nearly_every_of_50_episodes(stack_simulator):
    steps = np.array([run(stack_simulator, seed) for seed in seed_range("test", 50)])
    assert (steps <= LIMIT).mean() >= 0.97 and 85 < steps[steps <= LIMIT].mean() < 115, steps


def test_the_expert_leaves_the_stack_alone(stack_simulator):
    assert run(stack_simulator, 3) <= LIMIT
    stacked = stack_simulator.poses()[[A, B]]
    expert = TASK.expert(np.random.default_rng(0))
    outcomes = [stack_simulator.step(expert.act(stack_simulator.poses(), stack_simulator.goal())) for _ in range(20)]
    assert all(o.success and not o.grasped for o in outcomes)
    np.testing.assert_allclose(stack_simulator.poses()[[A, B], :3], stacked[:, :3], atol=2e-3)
    assert TASK.robot.tool(stack_simulator.poses())[2] > stack_simulator.poses()[A, 2] + 0.05  # and retreats


def test_the_expert_grasps_again_what_was_dropped(stack_simulator):
    stack_simulator.reset(11)
    expert = TASK.expert(np.random.default_rng(1))
    for _ in range(LIMIT):
        stack_simulator.step(expert.act(stack_simulator.poses(), stack_simulator.goal()))
        if stack_simulator.poses()[A, 2] > 0.05:
            break
    for _ in range(6):
        outcome = stack_simulator.step(np.array([0, 0, 0, 0, 0, 0, 1], np.float32))
    assert not outcome.grasped
    steps = (stack_simulator.step(expert.act(stack_simulator.poses(), stack_simulator.goal())) for _ in range(LIMIT))
    assert any(outcome.success for outcome in steps)


def test_there_is_no_goal(stack_simulator):
    stack_simulator.reset(0)
    assert stack_simulator.goal().shape == (TASK.goal_size,) == (0,)


def test_open_fingers_come_down_beside_the_other_cube():
    """Cube B lies 6 cm from cube A in the direction in which the nearest turn would open the fingers."""
    from scipy.spatial.transform import Rotation

    expert = TASK.expert(np.random.default_rng(0))
    for yaw in (0.0, 0.3):
        poses = np.zeros((5, 7))
        poses[:, 3] = 1.0
        poses[:3, 3:] = Rotation.from_euler("xz", [np.pi, 0.0]).as_quat(scalar_first=True)
        poses[:3, :3] = [0.6, 0.0, 0.3]
        axis = Rotation.from_euler("z", yaw)
        poses[A, :3] = [0.6, 0.0, 0.02]
        poses[A, 3:] = axis.as_quat(scalar_first=True)
        poses[B, :3] = poses[A, :3] + axis.apply([0.0, 0.06, 0.0])
        turn = expert.grasp._turn(poses)
        fingers = Rotation.from_euler("z", turn).apply([0.0, 1.0, 0.0])
        assert abs(fingers @ axis.apply([0.0, 1.0, 0.0])) < 1e-6
        poses[B, :3] = poses[A, :3] + axis.apply([0.06, 0.0, 0.0])
        assert expert.grasp._turn(poses) == pytest.approx(yaw)
