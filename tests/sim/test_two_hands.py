from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.robots import ArmKinematics
from pwm_gym.robots.two_hands import DRIVEN, JOINT_NAMES, TWO_HANDS, tool_pose
from pwm_gym.sim.maniskill.scenes import TwoArmBoxCleanupEnv
from pwm_gym.tasks import get_task

TASK = get_task("TwoArmBoxCleanup")


@pytest.fixture(scope="module")
def twin():
    env = gym.make("pwm/TwoArmBoxCleanupSim-v0")
    yield env
    env.close()


def flat():
    """Action that asks for nothing, with straight fingers."""
    action = np.zeros(24, np.float32)
    action[6:12] = action[18:24] = -1.0
    return action


def test_links_are_where_the_joints_put_them(twin):
    twin.reset(seed=0)
    for _ in range(3):
        twin.step(twin.action_space.sample())
    simulator = twin.unwrapped.simulator
    joints, poses = simulator.joints()[0], simulator.poses()
    for arm in TWO_HANDS.control.arms:
        hand = ArmKinematics(arm.chain)(torch.as_tensor(joints[None, arm.joints]))[0]
        np.testing.assert_allclose(poses[TASK.layout.index(arm.hand), :3], hand[:3, 3].numpy(), atol=1e-4)


def test_second_joints_follow_the_first(twin):
    twin.reset(seed=0)
    action = flat()
    action[8:12] = action[20:24] = [0.2, -0.4, 0.8, -0.9]
    for _ in range(8):
        twin.step(action)
    joints = dict(zip(JOINT_NAMES, twin.unwrapped.simulator.joints()[0], strict=True))
    for name, joint in TWO_HANDS.joints.items():
        if joint.mimic is not None:
            expected = joint.mimic.multiplier * joints[f"{joint.mimic.entity}_joint"] + joint.mimic.offset
            assert joints[f"{name}_joint"] == pytest.approx(expected, abs=5e-3)
    for side, start in (("left", 8), ("right", 20)):
        bent = [joints[f"{name}_joint"] for name in DRIVEN[side][2:]]
        np.testing.assert_allclose(bent, 0.8 * (action[start : start + 4] + 1.0), atol=0.02)


def test_the_same_seed_in_a_fresh_scene_is_equal_bit_for_bit(twin, random_actions):
    runs = []
    for seed in (3, 4, 3):
        twin.reset(seed=seed)
        for action in random_actions(0, 12, 24):
            twin.step(action)
        runs.append(np.r_[twin.unwrapped.simulator.poses().ravel(), twin.unwrapped.simulator.joints().ravel()])
    assert (runs[0] == runs[2]).all() and (runs[0] != runs[1]).any()


def test_an_arm_that_cannot_reach_its_target_holds_and_says_so(twin):
    _, info = twin.reset(seed=0)
    assert info["holding"] == ""
    away = flat()
    away[14] = 1.0  # the right hand up, until its arm is straight
    for _ in range(40):
        *_, info = twin.step(away)
    assert info["holding"] == "right"
    before = tool_pose(twin.unwrapped.simulator.poses(), "right")
    for _ in range(5):
        *_, info = twin.step(away)
    after = tool_pose(twin.unwrapped.simulator.poses(), "right")
    assert info["holding"] == "right" and np.linalg.norm(after[:3] - before[:3]) < 5e-3
    *_, info = twin.step(flat())
    assert info["holding"] == ""


@pytest.mark.parametrize("count", [7, 12])
def test_actions_of_other_robots_are_refused(twin, count):
    twin.reset(seed=0)
    with pytest.raises(PwmGymError, match=rf"\({count},\).*\(24,\)"):
        twin.step(np.zeros(count, np.float32))


def test_poses_that_are_not_finite_are_one_error(twin, monkeypatch):
    twin.reset(seed=0)
    simulator = twin.unwrapped.simulator
    lost = SimpleNamespace(pose=SimpleNamespace(p=np.full(3, np.nan), q=np.array([1.0, 0.0, 0.0, 0.0])))
    monkeypatch.setitem(simulator._entities, "lid", lost)
    with pytest.raises(SceneError, match="TwoArmBoxCleanup-v1: the simulator's pose of 'lid' is not finite"):
        twin.step(flat())


def test_a_hand_without_its_following_joints_is_refused(monkeypatch):
    monkeypatch.setattr("pwm_gym.sim.maniskill.two_hands.JOINT_NAMES", (*JOINT_NAMES, "left_index_3_joint"))
    with pytest.raises(PwmGymError, match="no joint 'left_index_3_joint'; two hands are driven by all of 35"):
        TASK.make_simulator()


def test_it_is_made_as_maniskills_users_do():
    env = gym.make("TwoArmBoxCleanup-v1", obs_mode="state_dict", render_backend="none", sim_backend="physx_cpu")
    observation, _ = env.reset(seed=0)
    assert observation["extra"]["lid_pose"].shape == (1, 7) and env.action_space.shape == (24,)
    _, reward, terminated, _, info = env.step(env.action_space.sample())
    assert 0 < float(reward) < 1 and not terminated and not info["success"]
    assert isinstance(env.unwrapped, TwoArmBoxCleanupEnv)
    env.close()
