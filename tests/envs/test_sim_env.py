"""The simulator twin: seeds, scenes to and from both twins, the meaning of actions."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import pwm_gym
from pwm_gym.errors import SceneError
from pwm_gym.tasks import get_task

OPEN, SHUT = (np.array([0, 0, 0, 0, 0, 0, g], np.float32) for g in (1, -1))


def poses(env) -> np.ndarray:
    return env.unwrapped.simulator.poses()


def width(env) -> float:
    """Distance between the fingers' origins in metres."""
    left, right = poses(env)[1:3, :3]
    return float(np.linalg.norm(left - right))


def play(env, steps: int, seed: int = 0) -> list[np.ndarray]:
    """Actions of the scripted expert, applied."""
    expert = get_task("PickCube").expert(np.random.default_rng(seed))
    actions = []
    for _ in range(steps):
        actions.append(expert.act(poses(env), env.unwrapped.scene().goal))
        env.unwrapped.step(actions[-1])
    return actions


def test_a_seed_is_an_episode_of_the_simulator(sim, random_actions):
    def run():
        out = [sim.reset(seed=3)[0]["points"]]
        return [*out, *(sim.step(a)[0]["points"] for a in random_actions(0, 10, 7))]

    first = run()
    sim.reset(seed=4)
    np.testing.assert_array_equal(run(), first)
    assert (sim.reset(seed=4)[0]["points"] != first[0]).any()


def test_unseeded_resets_follow_the_first_seed(sim):
    def goals():
        sim.reset(seed=5)
        return [sim.reset()[0]["goal"] for _ in range(2)]

    first = goals()
    np.testing.assert_array_equal(goals(), first)
    assert (first[0] != first[1]).any()


def test_the_simulators_info(sim, random_actions):
    for info in (sim.reset(seed=0)[1], sim.step(random_actions(0, 7))[-1]):
        assert type(info["simulator_reward"]) is float and 0 < info["simulator_reward"] < 1
        assert info["simulator_grasped"] is False


def test_reward_agrees_with_the_simulators_own(sim):
    """The default cost ports it to clouds."""
    sim.reset(seed=1)
    *_, reward, _, _, info = sim.step(OPEN)
    assert reward == pytest.approx(info["simulator_reward"], abs=0.02)


def test_positive_gripper_opens_and_negative_shuts(sim):
    sim.reset(seed=0)
    for _ in range(5):
        sim.step(OPEN)
    assert width(sim) > 0.07
    for _ in range(5):
        sim.step(SHUT)
    assert width(sim) < 0.01
    for _ in range(5):
        sim.step(OPEN)
    assert width(sim) > 0.07


@pytest.mark.parametrize(("axis", "sign"), [(a, s) for a in range(3) for s in (1, -1)])
def test_translations_move_the_tool_along_the_bases_axes(sim, axis, sign):
    sim.reset(seed=0)
    start = poses(sim)[0, :3]
    for _ in range(3):
        sim.step(OPEN + sign * 0.3 * np.eye(7, dtype=np.float32)[axis])
    moved = poses(sim)[0, :3] - start
    assert sign * moved[axis] > 0.02
    assert np.abs(np.delete(moved, axis)).max() < 0.01


def test_the_hand_is_in_the_bases_frame(sim):
    """PickCube's tool starts 0.6 m before the robot's base."""
    sim.reset(seed=0)
    assert np.abs(poses(sim)[0, :2] - [0.615, 0]).max() < 0.1


@pytest.mark.parametrize("steps", [0, 5, 20, 35, 50], ids=lambda s: f"after {s}")
def test_its_own_scene_restores_and_replays(sim, steps):
    """At rest, approaching and while the cube is held."""
    sim.reset(seed=1)
    play(sim, steps)
    scene = sim.unwrapped.scene()
    points = sim.unwrapped.state.points().numpy()
    velocity = sim.unwrapped.state.velocity()[0].numpy()
    truth = []
    actions = []
    for _ in range(10):
        actions += play(sim, 1)
        truth.append(poses(sim))
    observation, _ = sim.reset(options={"scene": scene})
    np.testing.assert_allclose(poses(sim), scene.poses[0], atol=1e-4)
    np.testing.assert_allclose(observation["points"], points[0], atol=1e-4)
    np.testing.assert_allclose(observation["velocity"], velocity, atol=1e-6)
    np.testing.assert_allclose(observation["goal"], scene.goal, atol=1e-6)
    for action, wanted in zip(actions, truth, strict=True):
        sim.unwrapped.step(action)
        assert np.linalg.norm(poses(sim)[:, :3] - wanted[:, :3], axis=-1).max() < 0.003


def test_a_restored_scene_knows_whether_the_gripper_was_shut(sim):
    sim.reset(seed=1)
    play(sim, 45)
    scene = sim.unwrapped.scene()
    assert scene.last_action[-1] == -1
    *_, info = sim.reset(options={"scene": scene})
    assert info["grasped"]
    *_, info = sim.step(scene.last_action)
    assert info["grasped"] and info["simulator_grasped"]  # the simulator feels contacts once it has stepped
    *_, info = sim.reset(options={"scene": replace(scene, last_action=None)})
    assert not info["grasped"]  # an open gripper is assumed


def test_the_model_starts_from_the_simulators_scene(sim, env):
    sim.reset(seed=2)
    play(sim, 8)
    scene = sim.unwrapped.scene()
    state = sim.unwrapped.state
    observation, _ = env.reset(options={"scene": scene})
    np.testing.assert_allclose(observation["points"], state.points()[0], atol=1e-5)
    np.testing.assert_allclose(observation["velocity"], state.velocity()[0], atol=1e-5)
    np.testing.assert_allclose(observation["previous_velocity"], state.previous_velocity()[0], atol=1e-5)
    np.testing.assert_array_equal(observation["goal"], scene.goal)
    assert np.abs(observation["velocity"]).max() > 1e-3
    again = env.unwrapped.scene()
    np.testing.assert_allclose(again.poses[..., :3], scene.poses[..., :3], atol=1e-5)
    np.testing.assert_array_equal(again.last_action, scene.last_action)


def test_a_model_of_fewer_points_takes_the_same_scene(sim):
    fewer = gym.make("pwm/PickCube-v0", points=600)
    full, _ = sim.reset(seed=2)
    some, _ = fewer.reset(options={"scene": sim.unwrapped.scene()})
    assert some["points"].shape == (600, 3)
    near = np.abs(some["points"][:, None] - full["points"][None]).sum(-1).min(1)
    assert near.max() < 1e-4


def test_scene_file_round_trip_with_joints(sim, tmp_path, random_actions):
    sim.reset(seed=0)
    sim.step(random_actions(0, 7))
    scene = sim.unwrapped.scene()
    scene.save(tmp_path / "scene.npz")
    again = pwm_gym.Scene.load(tmp_path / "scene.npz")
    np.testing.assert_array_equal(again.joints, scene.joints)
    sim.reset(seed=9)
    sim.reset(options={"scene": again})
    np.testing.assert_allclose(poses(sim), scene.poses[0], atol=1e-4)


def test_a_scene_without_joints_is_refused(sim, scene):
    sim.reset(seed=0)
    with pytest.raises(SceneError, match=r"scene\.joints is None"):
        sim.reset(options={"scene": replace(scene, joints=None)})


def test_success_terminates(sim):
    sim.reset(seed=0)
    for _ in range(3):
        sim.step(OPEN)
    scene = sim.unwrapped.scene()
    *_, terminated, _, info = sim.step(OPEN)
    assert not terminated and not info["success"]
    cube = scene.poses[0, scene.layout.index("cube"), :3].astype(np.float32)
    sim.reset(options={"scene": replace(scene, goal=cube)})
    _, reward, terminated, truncated, info = sim.step(OPEN)
    assert terminated and not truncated and info["success"]
    assert info["simulator_reward"] == pytest.approx(1.0)
    assert reward == pytest.approx(1.0, abs=1e-5)


def test_own_cost_on_the_true_clouds(random_actions):
    env = gym.make("pwm/PickCubeSim-v0", cost=lambda points, info: points["cube"].mean(-2)[..., 2])
    env.reset(seed=0)
    observation, reward, *_ = env.step(OPEN)
    assert reward == pytest.approx(-observation["points"][900:, 2].mean(), abs=1e-6)
    assert reward == pytest.approx(-0.02, abs=0.005)  # the cube's half width: it lies on the table
    env.close()


def test_no_scene_before_the_first_reset():
    env = gym.make("pwm/PickCubeSim-v0")
    with pytest.raises(pwm_gym.PwmGymError, match=r"no scene yet; call reset\(\) first"):
        env.unwrapped.scene()
    env.close()
