"""The learned model as a single environment: ends of episodes, scenes, costs."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch

import pwm_gym
from pwm_gym.scene import PointState

STILL = np.array([0, 0, 0, 0, 0, 0, 1], np.float32)


def test_success_terminates(env, scene, replace_model):
    replace_model(env)
    cube = scene.poses[0, scene.layout.index("cube"), :3]
    env.reset(options={"scene": replace(scene, goal=(cube + np.array([0, 0, 0.2])).astype(np.float32))})
    _, _, terminated, _, info = env.step(STILL)
    assert not terminated and not info["success"]
    env.reset(options={"scene": replace(scene, goal=cube.astype(np.float32))})
    _, reward, terminated, truncated, info = env.step(STILL)
    assert terminated and not truncated and info["success"]
    assert reward == pytest.approx(1.0, abs=1e-5)  # ManiSkill's reward of a success


def test_success_rule_does_not_follow_the_cost(scene, replace_model):
    env = gym.make("pwm/PickCube-v0", cost=lambda points, info: info["goal"].sum(-1) * 0 + 7.0)
    replace_model(env)
    cube = scene.poses[0, scene.layout.index("cube"), :3].astype(np.float32)
    env.reset(options={"scene": replace(scene, goal=cube)})
    _, reward, terminated, *_ = env.step(STILL)
    assert terminated and reward == -7.0


def far(poses):
    poses[..., :3, 3] += 5.0
    return poses


@pytest.mark.parametrize(
    "move",
    [far, lambda poses: poses * torch.nan, lambda poses: poses * torch.inf, lambda poses: poses * 1e30],
    ids=["far", "nan", "inf", "huge"],
)
@pytest.mark.parametrize("cost", ["pick_cube", "pick_cube_plan"])
def test_leaving_the_bounds_truncates(replace_model, move, cost):
    env = gym.make("pwm/PickCube-v0", cost=cost)
    env.reset(seed=0)
    replace_model(env, move)
    observation, reward, terminated, truncated, info = env.step(STILL)
    assert truncated and not terminated
    assert info["reason"] == "left the bounds"
    assert observation in env.observation_space
    assert np.isfinite(reward)
    _, info = env.reset(seed=0)
    assert info["reason"] == ""


def test_a_model_of_points_leaves_the_bounds_too(env):
    base = env.unwrapped

    class Points:
        links, action_size = base.model.links, base.model.action_size

        def prepare(self, state):
            return PointState.of(state)

        def step(self, state, action):
            return state.advance(state.points() * torch.nan)

    base.vector.model = Points()
    env.reset(seed=0)
    assert isinstance(base.state, PointState)
    observation, *_, truncated, info = env.step(STILL)
    assert truncated and info["reason"] == "left the bounds"
    assert observation in env.observation_space


def test_only_the_returned_observation_is_clipped(env, replace_model):
    env.reset(seed=0)
    replace_model(env, far)
    observation, *_ = env.step(STILL)
    assert observation["points"].max() == 2.0
    assert float(env.unwrapped.state.points().max()) > 5.0


def test_a_scene_starts_the_same_world(env, scene):
    first = env.reset(seed=0)[0]
    again, _ = env.reset(options={"scene": scene})
    for name, value in first.items():
        np.testing.assert_allclose(again[name], value, atol=1e-6)


def test_a_scene_from_mid_episode_goes_on_alike(env, random_actions):
    env.reset(seed=0)
    actions = random_actions(0, 10, 7)
    for action in actions[:5]:
        env.step(action)
    scene = env.unwrapped.scene()
    expected = [env.step(a)[0] for a in actions[5:]]
    start, _ = env.reset(options={"scene": scene})
    assert np.abs(start["velocity"]).max() > 1e-4
    for action, wanted in zip(actions[5:], expected, strict=True):
        found = env.step(action)[0]
        for name, value in wanted.items():
            np.testing.assert_allclose(found[name], value, atol=1e-4)


def test_scene_file_round_trip(env, scene, tmp_path, random_actions):
    env.step(random_actions(0, 7))
    scene = env.unwrapped.scene()
    scene.save(tmp_path / "scene.npz")
    again = pwm_gym.Scene.load(tmp_path / "scene.npz")
    assert (again.task, again.layout) == (scene.task, scene.layout)
    for name in ("clouds", "poses", "goal", "joints", "last_action"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scene, name))
    with np.load(tmp_path / "scene.npz", allow_pickle=False) as file:
        assert all(file[k].dtype != object for k in file.files)
    a, b = (env.reset(options={"scene": s})[0] for s in (scene, again))
    np.testing.assert_array_equal(a["points"], b["points"])


def test_own_cost_by_name(costs):
    @pwm_gym.register_cost("height_test")
    def height(points, info):
        return points["cube"].mean(-2)[..., 2]

    own = gym.make("pwm/PickCube-v0", cost="height_test")
    own.reset(seed=0)
    observation, reward, *_, info = own.step(STILL)
    assert reward == pytest.approx(-observation["points"][own.unwrapped.entities[3].slice, 2].mean(), abs=1e-6)
    assert list(info["cost_terms"]) == ["height_test"]


def test_own_cost_as_a_callable():
    def _height(points, info):
        return points["cube"].mean(-2)[..., 2]

    env = gym.make("pwm/PickCube-v0", cost=_height)
    env.reset(seed=0)
    *_, info = env.step(STILL)
    assert list(info["cost_terms"]) == ["_height"]


def test_a_cost_reads_action_goal_velocity():
    seen = {}

    def look(points, info):
        seen.update(info, names=list(points), cube=points["cube"])
        return info["action"].sum(-1)

    env = gym.make("pwm/PickCube-v0", cost=look)
    env.reset(seed=0)
    observation, reward, *_ = env.step(STILL * 0.5)
    assert reward == pytest.approx(-0.5)
    assert seen["names"] == ["hand", "left_gripper", "right_gripper", "cube"]
    assert seen["cube"].shape == (1, 300, 3) and seen["velocity"]["cube"].shape == (1, 300, 3)
    assert seen["grasped"].dtype == torch.bool
    np.testing.assert_array_equal(seen["goal"][0], observation["goal"])
    np.testing.assert_array_equal(seen["extra"]["goal_pos"][0], observation["goal"])


def test_the_papers_listing_runs_unchanged(costs):
    # fmt: off
    @pwm_gym.register_cost("pick_cube_paper_test", batched=False)
    def cost_fn_pick_cube(cfg, point, info):
        """
        Cost function for the PickCube-v1 task.
        """

        goal_xyz = torch.tensor(info['extra']['goal_pos'], device=cfg.device)

        left_gripper_xyz = point['left_gripper']
        right_gripper_xyz = point['right_gripper']
        cube_xyz = point['cube']

        cube_center_xyz = cube_xyz.mean(dim=0)
        tcp_xyz = (left_gripper_xyz.mean(dim=0) +
                   right_gripper_xyz.mean(dim=0)) / 2

        tcp_to_cube_dist = torch.norm(cube_center_xyz - tcp_xyz, dim=0)
        reaching_reward = 1.0 - torch.tanh(5.0 * tcp_to_cube_dist)

        cube_to_goal_dist = torch.norm(tcp_xyz - goal_xyz, dim=0)
        place_reward = 1.0 - torch.tanh(5.0 * cube_to_goal_dist)

        contact_reward = 1.0 if info['grasped'] else 0.0

        if info['grasped']:
            total_cost = -place_reward
        else:
            total_cost = -(reaching_reward + contact_reward)

        return total_cost
    # fmt: on

    many = gym.make_vec("pwm/PickCube-v0", num_envs=2, cost="pick_cube_paper_test")
    many.reset(seed=0)
    observation, rewards, *_, info = many.step(np.zeros((2, 7), np.float32))
    assert not info["grasped"].any()
    left, right, cube = (observation["points"][:, e.slice].mean(1) for e in many.unwrapped.entities[1:])
    reach = np.linalg.norm(cube - (left + right) / 2, axis=-1)
    np.testing.assert_allclose(rewards, 1 - np.tanh(5 * reach), atol=1e-5)


def test_the_papers_branch_follows_the_grasp(costs, scene, replace_model):
    """In the same scene, the unbatched function sees ``grasped`` as a plain bool."""
    seen = []

    @pwm_gym.register_cost("branch_test", batched=False)
    def branch(point, info):
        seen.append(info["grasped"])
        return -1.0 if info["grasped"] else -2.0

    poses = scene.poses.copy()
    poses[:, 3, :3] = poses[:, 0, :3] + [0, 0, -0.1034]  # the cube at the tool's centre
    env = gym.make("pwm/PickCube-v0", cost="branch_test")
    replace_model(env)
    env.reset(options={"scene": replace(scene, poses=poses)})
    rewards = [env.step(np.r_[np.zeros(6), g].astype(np.float32))[1] for g in (1.0, -1.0)]
    assert rewards == [2.0, 1.0]
    assert seen[-2:] == [False, True] and all(type(s) is bool for s in seen)
