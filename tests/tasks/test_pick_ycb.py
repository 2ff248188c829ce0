import gymnasium as gym
import numpy as np
import pytest
import torch

from pwm_gym.assets import (
    GENERATED_OBJECTS,
    OBJECT_SETS,
    MissingAssetsError,
    object_grasps,
    select_objects,
)
from pwm_gym.costs import cost_info, get_cost, get_grasp, get_success
from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.scene import Scene, batch_state, sample_clouds
from pwm_gym.seeds import seed_range
from pwm_gym.tasks import get_task

TASK = get_task("PickYCB")
OBJECT = TASK.layout.index("object")
TWO = ("shape_ball", "shape_bar")


@pytest.fixture(scope="module", autouse=True)
def shapes(only_shapes):
    """The generated shapes are all there is."""
    return only_shapes


@pytest.fixture(scope="module")
def twin(shapes):
    env = gym.make("pwm/PickYCBSim-v0", objects=TWO)
    yield env
    env.close()


@pytest.fixture(scope="module")
def episode(twin):
    """An expert's episode: scenes, actions and outcomes, until 5 steps past success."""
    simulator, seed = twin.unwrapped.simulator, seed_range("test", 1)[0]
    simulator.reset(seed)
    expert, assets = TASK.expert(np.random.default_rng(seed)), simulator.assets()
    clouds = sample_clouds(simulator.meshes(), TASK.layout, TASK.cloud_seed)
    poses, scenes, actions, outcomes = [simulator.poses()] * 3, [], [], []
    while sum(o.success for o in outcomes) < 5 and len(outcomes) < TASK.max_episode_steps:
        actions.append(expert.act(simulator.poses(), simulator.goal(), assets))
        outcomes.append(simulator.step(actions[-1]))
        poses.insert(0, simulator.poses())
        last = np.stack(poses[:3])
        scenes.append(Scene(TASK.name, TASK.layout, clouds, last, simulator.goal(), simulator.joints(), assets=assets))
    goals = torch.as_tensor(np.stack([scene.goal for scene in scenes]))
    view = cost_info(batch_state(scenes), torch.as_tensor(np.array(actions)), goals, get_grasp(TASK.grasp))
    return view, outcomes


def test_the_cost_is_minus_maniskills_reward_and_success_is_its_own(episode):
    view, outcomes = episode
    rewards = np.array([o.reward for o in outcomes])
    found = -get_cost("pick_ycb")(*view).numpy()
    assert np.corrcoef(found, rewards)[0, 1] > 0.97 and np.abs(found - rewards).mean() < 0.03
    success = np.array([o.success for o in outcomes])
    assert success.any() and (get_success("pick_ycb")(*view).numpy() == success).mean() > 0.95


def test_the_contact_rule_tells_maniskills_grasps(episode):
    view, outcomes = episode
    grasped = np.array([o.grasped for o in outcomes])
    assert grasped.any() and (get_grasp("pick_ycb_contact")(*view).numpy() == grasped).mean() > 0.9


def test_the_planning_cost_falls_along_a_demonstration_and_has_gradients(episode):
    (points, info), outcomes = episode
    leaves = {name: points[name].clone().requires_grad_() for name in points}
    cost = get_cost("pick_ycb_plan")(leaves, info)
    cost.sum().backward()
    assert leaves["object"].grad.isfinite().all() and leaves["object"].grad.abs().sum() > 0
    held = np.array([o.grasped for o in outcomes])
    assert cost[held][-1] < cost[held][0] < cost[~held][0]


def test_training_seeds_draw_one_of_the_objects_asked_for(twin):
    found = set()
    for seed in seed_range("train", 6):
        twin.reset(seed=seed)
        found.add(twin.unwrapped.scene().assets[OBJECT])
    assert found == set(TWO)


def test_a_scene_brings_its_own_object(twin):
    env = twin.unwrapped
    scenes = {}
    for seed in seed_range("validation", 6):
        env.reset(seed=seed)
        scenes[env.scene().assets[OBJECT]] = env.scene()
    first, second = (scenes[name] for name in TWO)
    env.reset(options={"scene": first})
    observation, _ = env.reset(options={"scene": second})
    assert env.simulator.assets() == second.assets
    np.testing.assert_allclose(env.simulator.poses(), second.poses[0], atol=1e-4)
    expected = batch_state([second]).points()[0].numpy()
    np.testing.assert_allclose(observation["points"], expected, atol=1e-4)
    assert np.abs(first.clouds - second.clouds).max() > 0.01
    np.testing.assert_array_equal(env.reset(seed=7)[0]["points"], env.reset(seed=7)[0]["points"])


def test_the_experts_grasps_are_looked_up_by_name(shapes):
    expert = TASK.expert(np.random.default_rng(0))
    assert expert.grasps("shape_bar").grasps == object_grasps(shapes, "shape_bar").grasps
    with pytest.raises(PwmGymError, match="was given no assets"):
        expert.act(np.zeros((4, 7)), np.zeros(3))


def test_objects_are_chosen_by_set_or_by_name(shapes):
    assert TASK.object_sets == OBJECT_SETS
    assert select_objects(shapes, "seen") == select_objects(shapes, "liftable") == GENERATED_OBJECTS
    assert select_objects(shapes, "shape_bar") == ("shape_bar",)
    with pytest.raises(PwmGymError, match="none of the 12 objects in .* is unseen and liftable"):
        select_objects(shapes, "unseen_liftable")
    with pytest.raises(UnknownNameError, match="'shape_botle'.*Did you mean 'shape_bottle'"):
        select_objects(shapes, "shape_botle")
    with pytest.raises(MissingAssetsError, match="has no object '011_banana'"):
        TASK.make_simulator(("011_banana",))
    with pytest.raises(PwmGymError, match="the objects of PickCube are always the same"):
        get_task("PickCube").make_simulator("seen")
