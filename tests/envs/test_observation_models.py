from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from gymnasium.envs.registration import EnvSpec

from pwm_gym.cameras.viewpoints import VIEWPOINTS
from pwm_gym.completion import HullCompleter
from pwm_gym.envs import CameraConfig, SimEnv
from pwm_gym.envs.camera_models import depth_camera
from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.evaluation import chamfer
from pwm_gym.experiments.distractors import add_distractors
from pwm_gym.planning import Agent, MPPIConfig, Run, execute
from pwm_gym.scene import Layout, batch_state
from pwm_gym.tasks import TASKS, get_task

SIM = "pwm/PickCubeSim-v0"


@pytest.fixture(scope="module")
def completed():
    env = gym.make(SIM, observation="completed", camera=CameraConfig(completer="hull", sensor="d455"))
    yield env
    env.close()


@pytest.fixture(scope="module")
def partial():
    env = gym.make(SIM, observation="partial")
    yield env
    env.close()


def clouds(env):
    base = env.unwrapped
    return [batch_state([base.scene(truth=t)]).points()[0].numpy() for t in (False, True)]


@pytest.mark.parametrize("name", ["completed", "partial"])
def test_what_is_shown_is_near_the_truth_but_not_it(name, request):
    env = request.getfixturevalue(name)
    for advance in (lambda: env.reset(seed=300_000), lambda: env.step(np.zeros(7, np.float32))):
        observation = advance()[0]
        shown, true = clouds(env)
        np.testing.assert_allclose(observation["points"], shown, atol=1e-6)
        assert observation in env.observation_space
        assert 0 < chamfer(shown, true) < 0.03
        cube = env.unwrapped.layout["cube"].slice
        assert np.linalg.norm(shown[cube].mean(0) - true[cube].mean(0)) < 0.02
    robot = env.unwrapped.layout["cube"].start
    if name == "completed":
        np.testing.assert_allclose(shown[:robot], true[:robot], atol=1e-4)
    else:
        assert chamfer(shown[:robot], true[:robot]) > 1e-3


@pytest.mark.parametrize("name", ["completed", "partial"])
def test_a_camera_sees_further_bodies_which_observations_leave_out(name, sim, request):
    env = request.getfixturevalue(name)
    sim.reset(seed=300_000)
    crowded = add_distractors(sim.unwrapped.scene(), "cube", 3, count=2, near=0)
    observation, _ = env.reset(options={"scene": crowded})
    assert observation in env.observation_space
    for _ in range(2):
        shown, true = (batch_state([env.unwrapped.scene(truth=t)]) for t in (False, True))
        assert shown.layout.names == true.layout.names == crowded.layout.names
        for further in crowded.layout.names[-2:]:
            gap = (shown.entity(further).mean(1) - true.entity(further).mean(1)).norm()
            assert 0 < float(gap) < 0.03
        observation = env.step(np.zeros(7, np.float32))[0]
    assert observation in env.observation_space
    env.reset(seed=300_000)
    assert env.unwrapped.scene().layout == env.unwrapped.layout


def test_the_seed_decides_the_sensors_noise(completed):
    first = completed.reset(seed=300_000)[0]["points"]
    assert not np.array_equal(completed.reset(seed=300_001)[0]["points"], first)
    np.testing.assert_array_equal(completed.reset(seed=300_000)[0]["points"], first)


def test_the_reward_is_of_the_truth_and_info_tells_of_the_estimate(completed, sim):
    _, info = completed.reset(seed=300_000)
    _, expected = sim.reset(seed=300_000)
    assert info["cost_terms"] == expected["cost_terms"]
    assert set(info) - set(expected) == {"completion_error", "perception_seconds"}
    assert list(info["completion_error"]) == ["cube"] and 0 < info["perception_seconds"] < 5


def test_an_agent_plans_from_what_is_shown_and_the_record_holds_the_truth(completed, env, tmp_path):
    agent = Agent(env.unwrapped.model, "PickCube", MPPIConfig(samples=8, elites=2, horizon=3))
    run = execute(completed, agent, 300_000, max_steps=3)
    real = completed.unwrapped.scene(truth=True)
    np.testing.assert_array_equal(run.start.clouds, real.clouds)
    np.testing.assert_array_equal(run.poses[-1], real.poses[0])
    assert not np.array_equal(run.shown.clouds, run.start.clouds)
    run.save(tmp_path / "run.npz")
    again = Run.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(again.shown.clouds, run.shown.clouds)
    np.testing.assert_array_equal(again.shown.poses, run.shown.poses)


def test_an_unknown_checkpoint_of_completion_is_named():
    with pytest.raises(UnknownNameError, match="unknown checkpoint of completion 'nothing'"):
        gym.make(SIM, observation="completed", camera=CameraConfig(completer="nothing"))


def test_a_completer_of_ones_own():
    calls = []

    class Mine(HullCompleter):
        def __call__(self, partial, eye, points=2048):
            calls.append(points)
            return super().__call__(partial, eye, points)

    env = gym.make(SIM, observation="completed", points=400, camera=CameraConfig(completer=Mine()))
    env.reset(seed=300_000)
    env.step(np.zeros(7, np.float32))
    env.close()
    assert calls == [100]  # once an episode


OVERHEAD = {"eye": [0.6, 0.0, 1.0], "target": [0.6, 0.0, 0.0], "fov": 60.0, "width": 96, "height": 96}


@pytest.mark.parametrize(
    "camera",
    [CameraConfig("left", sensor="d455"), CameraConfig(OVERHEAD), {"viewpoint": "front"}, "left", None],
    ids=["named", "numbers", "dict", "viewpoint", "default"],
)
def test_camera_settings_survive_a_specs_json(camera):
    env = gym.make(SIM, observation="partial", camera=camera)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    first, second = (e.reset(seed=300_000)[0]["points"] for e in (env, again))
    np.testing.assert_array_equal(first, second)
    env.close()
    again.close()


def test_viewpoints_show_different_points(partial):
    left = gym.make(SIM, observation="partial", camera="left")
    first, second = (e.reset(seed=300_000)[0]["points"] for e in (partial, left))
    assert not np.array_equal(first, second)
    left.close()


def test_a_viewpoint_is_a_name_numbers_or_a_camera():
    own = VIEWPOINTS["front"].resize(3)
    assert depth_camera(own, 2) is own
    assert depth_camera("front", 2).width == 2 * VIEWPOINTS["front"].width
    assert depth_camera(OVERHEAD, 2).width == 96


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ("lift", "unknown viewpoint 'lift'.*Did you mean 'left'"),
        ({"viewpont": "left"}, "unknown camera setting 'viewpont'.*Did you mean 'viewpoint'"),
        ({"viewpoint": {"eye": (0, 0, 1), "goal": (0, 0, 0)}}, "unexpected keyword argument 'goal'"),
        (5, "camera is a int; expected a CameraConfig"),
        ({"sensor": "d456"}, "unknown sensor.*'d456'"),
    ],
)
def test_a_camera_that_cannot_be_is_named(camera, message):
    with pytest.raises(PwmGymError, match=message):
        gym.make(SIM, observation="completed", camera=camera)


class TwoObjects:
    """PickCube's simulator at rest, with a second object beside the cube whose asset the seed decides."""

    def __init__(self, simulator):
        self._simulator = simulator
        self.reset(0)

    def __getattr__(self, name):
        return getattr(self._simulator, name)

    def reset(self, seed):
        self._simulator.reset(300_000)
        self._large = seed % 2 == 0

    def assets(self):
        return (*self._simulator.assets(), "large" if self._large else "small")

    def meshes(self):
        side = 0.06 if self._large else 0.03
        return {**self._simulator.meshes(), "other": trimesh.creation.box([side] * 3)}

    def poses(self):
        poses = self._simulator.poses()
        beside = poses[3] + np.array([0.05, 0.15, 0.01, 0, 0, 0, 0])
        return np.concatenate([poses, beside[None]])

    def close(self):
        pass


def test_several_objects_are_completed_and_their_assets_may_change(simulator, monkeypatch):
    pick = get_task("PickCube")
    layout = pick.layout.plus(Layout.build([("other", 300)]).entities)
    task = replace(pick, name="TwoObjects", layout=layout, simulator=lambda: TwoObjects(simulator))
    monkeypatch.setitem(TASKS, "TwoObjects", task)
    env = SimEnv("TwoObjects", observation="completed", camera={"completer": "hull"})
    sizes = []
    for seed in (0, 1):
        observation, info = env.reset(seed=seed)
        assert observation in env.observation_space and set(info["completion_error"]) == {"cube", "other"}
        shown, true = (batch_state([env.scene(truth=t)]) for t in (False, True))
        for name in ("cube", "other"):
            assert (shown.entity(name).mean(-2) - true.entity(name).mean(-2)).norm() < 0.02
        sizes.append(float(np.ptp(shown.entity("other")[0].numpy(), axis=0)[2]))
        assert env.scene().assets == env.scene(truth=True).assets
        env.step(np.zeros(7, np.float32))
    assert sizes == pytest.approx([0.06, 0.03], abs=0.015)
