"""Scenes that differ from PickCube's: other assets an episode, no goal, several arms, clutter beside the task."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from pwm_gym.envs import ModelEnv, ModelVectorEnv, SimEnv
from pwm_gym.envs.camera_models import carried_objects
from pwm_gym.errors import SceneError, UnknownNameError
from pwm_gym.planning import Agent, MPPIConfig, Run, execute
from pwm_gym.scene import Layout, RigidState, sample_surface
from pwm_gym.tasks import get_task
from pwm_gym.wrappers import EntityPoses, FlattenPoints, RecordRollout, Twin

REST = np.zeros(24, np.float32)
PLAN = MPPIConfig(samples=16, elites=4, horizon=3)


def block(env):
    base = env.unwrapped
    return base.scene().clouds[base.layout["block"].slice]


# Tasks without a goal, with several arms ---------------------------------------------------------------------------


@pytest.mark.parametrize("make", [ModelEnv, SimEnv])
def test_a_task_without_a_goal_conforms(toy, make):
    env = make("Toy")
    assert env.observation_space["goal"].shape == (0,) and env.action_space.shape == (24,)
    check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space and env.goal.shape == (1, 0)
    assert FlattenPoints(env).observation(observation).shape == (9 * 200,)
    assert EntityPoses(env).observation(observation).shape == (12 * 4,)


def test_a_native_batch_without_a_goal(toy):
    env = ModelVectorEnv("Toy", num_envs=3)
    observation, _ = env.reset(seed=0)
    assert observation["goal"].shape == (3, 0)
    observation, reward, *_ = env.step(np.zeros((3, 24), np.float32))
    assert observation in env.observation_space and reward.shape == (3,)


def test_planning_without_a_goal_is_executed_and_recorded(toy, tmp_path):
    env = SimEnv("Toy")
    run = execute(env, Agent(ModelEnv("Toy").model, "Toy", PLAN), seed=3, max_steps=3)
    assert run.actions.shape == (3, 24) and run.start.goal.shape == (0,)
    run.save(tmp_path / "run.npz")
    again = Run.load(tmp_path / "run.npz")
    assert again.start.goal.shape == (0,) and again.start.assets == run.start.assets
    np.testing.assert_array_equal(again.actions, run.actions)


def test_a_scene_that_tells_no_last_action_rests(toy):
    env = ModelEnv("Toy")
    env.reset(seed=0)
    np.testing.assert_array_equal(env.scene().last_action, REST)


# Other assets an episode -------------------------------------------------------------------------------------------


def test_the_simulators_clouds_are_those_of_the_episodes_assets(toy):
    env = SimEnv("Toy")
    env.reset(seed=0)
    large, meshes = block(env), env.simulator.meshes()
    np.testing.assert_array_equal(large, sample_surface(meshes["block"], 60, toy.cloud_seed + 2))
    assert env.scene().assets == ("left_hand", "right_hand", "large_block", "ball")
    env.reset(seed=1)
    small = block(env)
    assert np.abs(large).max() > 1.5 * np.abs(small).max() and env.scene().assets[2] == "small_block"
    made = env.simulator.meshes_made
    env.reset(seed=2)
    np.testing.assert_array_equal(block(env), large)
    assert env.simulator.meshes_made == made  # both are known by now


def test_fewer_points_are_the_first_of_each_asset(toy):
    full, fewer = SimEnv("Toy"), SimEnv("Toy", points=100)
    for env in (full, fewer):
        env.reset(seed=0)
    np.testing.assert_array_equal(block(fewer), block(full)[:30])


def test_a_scene_restores_with_its_assets(toy):
    env = SimEnv("Toy")
    env.reset(seed=0)
    env.step(np.full(24, 0.5, np.float32))
    scene, points = env.scene(), env.state.points()
    env.reset(seed=1)
    env.reset(options={"scene": scene})
    assert env.simulator.assets() == scene.assets == env.scene().assets
    torch.testing.assert_close(env.state.points(), points)


def test_a_simulator_that_names_too_few_assets_is_refused(toy, monkeypatch):
    env = SimEnv("Toy")
    monkeypatch.setattr(env.simulator, "assets", lambda: ("block",))
    with pytest.raises(SceneError, match="names 1 assets; expected one for each of left_hand, right_hand, block, ball"):
        env.reset(seed=0)


def test_the_models_bank_holds_scenes_of_several_assets(toy):
    env = ModelVectorEnv("Toy", num_envs=8, autoreset_mode="Disabled")
    env.reset(seed=0)
    scenes = [env.scene(i) for i in range(8)]
    sizes = {s.assets[2]: float(np.abs(s.clouds[env.layout["block"].slice]).max()) for s in scenes}
    assert set(sizes) == {"small_block", "large_block"}
    assert sizes["large_block"] == pytest.approx(2 * sizes["small_block"])
    large = next(s for s in scenes if s.assets[2] == "large_block")
    mask = np.array([s.assets[2] == "small_block" for s in scenes])
    env.reset(options={"scene": large, "reset_mask": mask})
    assert {env.scene(i).assets[2] for i in range(8)} == {"large_block"}
    assert env.state.clouds.std(0).max() == 0


def test_twins_share_the_assets_of_a_scene(toy):
    twin = Twin(ModelEnv("Toy"), SimEnv("Toy"))
    for seed in (0, 1):
        _, info = twin.reset(seed=seed)
        assert info["divergence"]["chamfer_l1"] < 1e-6
        assert twin.unwrapped.scene().assets == twin.twin.unwrapped.scene().assets


def test_a_camera_sees_the_episodes_assets_and_what_hides_what(toy):
    """The large block hides the ball from a camera that looks along x; the small one does not hide all of it."""
    camera = {"viewpoint": {"eye": (0.1, 0.0, 0.05), "target": (0.8, 0.0, 0.04), "width": 256, "height": 256}}
    env = SimEnv("Toy", observation="partial", camera=camera)
    near = []
    for seed, moved in ((0, 0.0), (0, 0.3), (1, 0.0)):
        env.reset(seed=seed)
        scene = env.scene(truth=True)
        poses = scene.poses.copy()
        poses[:, 2, 1] += moved  # the block, out of the way
        env.reset(options={"scene": replace(scene, poses=poses)})
        ball = env.scene().clouds[env.layout["ball"].slice]
        near.append(float((ball[:, 0] < 0.005).mean()))
    hidden, clear, _ = near
    assert clear == 1.0  # the camera sees the ball's near side alone
    assert hidden < 0.8  # an entity that is never seen keeps points of all sides
    assert block(env).shape == (60, 3) and np.abs(block(env)).max() < 0.03  # of the small block


def test_a_robot_of_unknown_kinematics_is_where_it_says_it_is(toy):
    """Links stand as reported, with the twin's own clouds; objects are completed from what the camera sees."""
    camera = {"viewpoint": {"eye": (0.3, 0.0, 1.2), "target": (0.5, 0.0, 0.0), "width": 256, "height": 256}}
    env = SimEnv("Toy", observation="completed", camera={**camera, "completer": "hull"})
    env.reset(seed=0)
    env.step(REST)
    seen, truth = env.scene(), env.scene(truth=True)
    for entity in env.layout:
        i, part = env.layout.index(entity.name), entity.slice
        if entity.driven:
            np.testing.assert_allclose(seen.poses[:, i, :3], truth.poses[:, i, :3], atol=1e-6)
            np.testing.assert_array_equal(seen.clouds[part], truth.clouds[part])
        else:
            assert not np.array_equal(seen.clouds[part], truth.clouds[part])
            away = seen.poses[0, i, :2] - truth.poses[0, i, :2]  # how far down it goes is not seen from above
            assert np.linalg.norm(away) < 0.02
    assert set(env.reset(seed=1)[1]["completion_error"]) == {e.name for e in env.layout if e.loose}


# Which object is carried -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("held", ["cube", "other", None])
def test_any_object_may_be_carried(held):
    """A grasp rule asks about the task's cube; it is asked about the other one, too."""
    task = get_task("PickCube")
    layout = task.layout.plus(Layout.build([("other", 300)]).entities)
    places = {"hand": 0.2, "left_gripper": 0.1416, "right_gripper": 0.1416}
    frames = torch.eye(4).repeat(1, 3, len(layout), 1, 1)
    clouds = torch.rand(1, layout.points, 3, generator=torch.Generator().manual_seed(0)) * 0.04 - 0.02
    for i, name in enumerate(layout.names):
        height = places.get(name, 0.12 if name == held else 0.02)
        frames[..., i, :3, 3] = torch.tensor([0.5 if name in places or name == held else 0.7, 0.0, height])
    for name, side in (("left_gripper", 1), ("right_gripper", -1)):
        frames[..., layout.index(name), 1, 3] = side * 0.0397
    action = torch.tensor([[0.0, 0, 0, 0, 0, 0, -1]])
    found = carried_objects(task, RigidState(layout, clouds, frames), action, torch.zeros(1, 3))
    assert found == ({} if held is None else {held: "hand"})


# Clutter -----------------------------------------------------------------------------------------------------------


def test_further_entities_move_and_costs_read_them_but_observations_do_not(env, scene, clutter, sliding):
    env = gym.make("pwm/PickCube-v0", cost=lambda points, info: points[[*points][-2]].mean(-2)[..., 0])
    sliding(env)
    crowded = clutter(scene, "bowl", "mug")
    plain, _ = gym.make("pwm/PickCube-v0").reset(options={"scene": scene})
    observation, _ = env.reset(options={"scene": crowded})
    np.testing.assert_array_equal(observation["points"], plain["points"])
    base = env.unwrapped
    assert base.state.layout.names[-2:] == ("bowl", "mug") and len(base.entities) == 4
    before = -float(base.state.entity("bowl")[..., 0].mean())
    observation, reward, *_ = env.step(np.zeros(7, np.float32))
    assert observation in env.observation_space
    assert reward == pytest.approx(before - 1e-3, abs=1e-6)
    after = base.scene()
    assert after.layout.names == crowded.layout.names and after.clouds.shape == (1260, 3)
    np.testing.assert_allclose(after.poses[0, -2:, 0], crowded.poses[0, -2:, 0] + 1e-3, atol=1e-6)
    env.reset(options={"scene": after})  # and on from there
    env.reset(seed=0)  # the bank's scenes have none
    assert base.state.layout == base.vector.layout


def test_fewer_points_leave_further_entities_whole(scene, clutter, sliding):
    env = gym.make("pwm/PickCube-v0", points=400)
    sliding(env)
    observation, _ = env.reset(options={"scene": clutter(scene, "bowl")})
    assert observation["points"].shape == (400, 3) and env.unwrapped.state.layout.points == 430


def test_wrappers_and_pictures_with_further_entities(scene, clutter, sliding, tmp_path):
    env = RecordRollout(EntityPoses(gym.make("pwm/PickCube-v0", render_mode="rgb_array")), tmp_path)
    sliding(env)
    for given in (scene, clutter(scene, "bowl")):
        observation, _ = env.reset(options={"scene": given})
        assert observation.shape == (51,) and env.render().dtype == np.uint8
        env.step(np.zeros(7, np.float32))
    env.close()
    with np.load(tmp_path / "episode-00001.npz") as saved:
        assert saved["poses"].shape == (2, 5, 7) and saved["clouds"].shape == (1230, 3)


def test_a_batch_of_cluttered_scenes(scene, clutter, sliding):
    env = gym.make_vec("pwm/PickCube-v0", num_envs=2, autoreset_mode="Disabled")
    sliding(env)
    env.reset(options={"scene": clutter(scene, "bowl")})
    base = env.unwrapped
    assert base.state.layout.names[-1] == "bowl"
    env.step(np.zeros((2, 7), np.float32))
    mask = np.array([True, False])
    env.reset(options={"scene": clutter(scene, "bowl"), "reset_mask": mask})
    for given in (scene, clutter(scene, "mug")):
        with pytest.raises(SceneError, match="expected those of the other environments"):
            env.reset(options={"scene": given, "reset_mask": mask})
    with pytest.raises(SceneError, match="expected those of the other environments"):
        env.reset(options={"scene": [scene, clutter(scene, "bowl")]})
    assert base.state.layout.names[-1] == "bowl"
    env.reset(options={"scene": scene})
    assert base.state.layout == base.layout


def test_cluttered_scenes_need_autoreset_disabled(scene, clutter):
    env = gym.make_vec("pwm/PickCube-v0", num_envs=2)
    with pytest.raises(SceneError, match="has bowl besides the task's entities; that needs autoreset_mode 'Disabled'"):
        env.reset(options={"scene": clutter(scene, "bowl")})


def test_further_entities_are_free(env, scene, clutter):
    crowded = clutter(scene, "bowl")
    driven = replace(crowded.layout.entities[-1], driven=True)
    layout = replace(crowded.layout, entities=(*scene.layout.entities, driven))
    with pytest.raises(SceneError, match="further entities bowl are not free"):
        env.reset(options={"scene": replace(crowded, layout=layout)})


def test_the_simulator_takes_further_entities_of_known_shapes(sim, clutter):
    sim.reset(seed=0)
    with pytest.raises(UnknownNameError, match="unknown prop 'distractor_cub'.*Did you mean 'distractor_cube'"):
        sim.reset(options={"scene": clutter(sim.unwrapped.scene(), "distractor_cub")})


def test_an_agent_plans_around_further_entities(env, scene, clutter, sliding):
    sliding(env)
    crowded = clutter(scene, "bowl")
    agent = Agent(env.unwrapped.model, "PickCube", PLAN, cost=lambda p, i: p["bowl"].mean(-2)[..., 0])
    assert agent.plan(crowded).shape == (3, 7)
    moved = agent.advance(np.zeros(7, np.float32))
    assert moved.layout.names[-1] == "bowl"

    class Starts(gym.Wrapper):
        def reset(self, **given):
            return self.env.reset(seed=given["seed"], options={"scene": crowded})

    run = execute(Starts(env), agent, seed=0, max_steps=2)
    assert run.poses.shape == (3, 5, 7) and run.predicted.shape == (2, 5, 7)
    with pytest.raises(SceneError, match="expected them to begin with"):
        agent.plan(replace(scene, layout=Layout.build([("cube", 1200)])))
