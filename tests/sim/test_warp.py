"""Worlds of a MuJoCo model that MuJoCo Warp steps, beside the simulator."""

import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import warp_double

from pwm_gym.errors import PwmGymError
from pwm_gym.sim.mujoco import MujocoSimulator
from pwm_gym.sim.mujoco.warp import WarpWorlds
from pwm_gym.tasks import get_task

ARM = """
<mujoco><worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <body name="upper" pos="0 0 0.05">
      <joint name="shoulder" type="hinge" axis="0 0 1" range="-150 150" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02"/>
      <body name="fore" pos="0.25 0 0">
        <joint name="elbow" type="hinge" axis="0 0 1" range="-150 150" damping="0.5"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02"/>
      </body>
    </body>
    <body name="box" pos="0.4 0.1 0.03999"><freejoint/><geom type="box" size="0.04 0.04 0.04" mass="0.2"/></body>
  </worldbody><actuator>
    <motor joint="shoulder" ctrlrange="-2 2"/> <motor joint="elbow" ctrlrange="-1 1"/>
  </actuator></mujoco>"""
STEPS = 12


def start(model, data, rng):
    data.qpos[:2] = rng.uniform(-0.1, 0.1, 2)
    return rng.uniform(0.3, 0.4, 3)


def arm(**options):
    return MujocoSimulator.from_xml(ARM, {k: k for k in ("upper", "fore", "box")}, start=start, **options)


def push(simulator, seeds):
    """Poses and joints of every step where both motors turn the arm into the box, a little faster in each world."""
    episodes = []
    for seed in seeds:
        simulator.reset(seed)
        shown = [(simulator.poses(), simulator.joints())]
        for _ in range(STEPS):
            simulator.step(np.array([1.0, 0.1 * seed]))
            shown.append((simulator.poses(), simulator.joints()))
        episodes.append(shown)
    return [np.array([[step[k] for step in shown] for shown in episodes]) for k in (0, 1)]


def push_in_worlds(worlds, seeds):
    worlds.reset(seeds)
    shown = [(worlds.poses(), worlds.joints())]
    for _ in range(STEPS):
        worlds.step(np.array([[1.0, 0.1 * seed] for seed in seeds]))
        shown.append((worlds.poses(), worlds.joints()))
    return [np.stack([step[k] for step in shown], 1) for k in (0, 1)]


@pytest.fixture
def double(monkeypatch):
    """The engine's double, with MuJoCo inside."""
    warp_double.install(monkeypatch)


@pytest.mark.parametrize("task", ["FetchPush", "FetchPickAndPlace", "AdroitHandDoor", "AdroitHandRelocate"])
def test_a_control_step_is_drive_steps_and_settle(task):
    whole, parts = get_task(task).make_simulator(), get_task(task).make_simulator()
    rng = np.random.default_rng(0)
    for simulator in (whole, parts):
        simulator.reset(3)
    for _ in range(4):
        action = rng.uniform(-1.0, 1.0, whole.action_size).astype(np.float32)
        whole.step(action)
        parts.data.qacc_warmstart[:] = 0.0
        parts.world.drive(action)
        mujoco.mj_step(parts.model, parts.data, nstep=parts.world.frame_skip)
        parts.world.settle()
        mujoco.mj_forward(parts.model, parts.data)
        np.testing.assert_array_equal(parts.poses(), whole.poses())
        np.testing.assert_array_equal(parts.joints(), whole.joints())
    whole.close()
    parts.close()


def test_worlds_show_what_the_simulator_shows(double):
    seeds = [1, 2, 5]
    poses, joints = push(arm(), seeds)
    assert np.linalg.norm(poses[:, -1, 2, :3] - poses[:, 0, 2, :3], axis=-1).min() > 0.01  # the box was pushed
    found, turned = push_in_worlds(WarpWorlds(arm(), 3), seeds)
    assert found.shape == (3, STEPS + 1, 3, 7) and turned.shape == (3, STEPS + 1, 2, 2)
    np.testing.assert_allclose(found, poses, atol=1e-4)
    np.testing.assert_allclose(turned, joints, atol=1e-4)


@pytest.mark.parametrize(
    "task", ["FetchPush", "AdroitHandDoor"]
)  # shut fingers; a door frame elsewhere in each episode
def test_worlds_step_as_environments_do(double, task):
    simulator, other = get_task(task).make_simulator(), get_task(task).make_simulator()
    worlds = WarpWorlds(other, 2, contacts=100)
    worlds.reset([3, 4])
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 2, simulator.action_size))
    for action in actions:
        worlds.step(action)
    for world, seed in enumerate([3, 4]):
        simulator.reset(seed)
        for action in actions[:, world]:
            outcome = simulator.step(action)
        shown = worlds.view(world)
        np.testing.assert_allclose(shown.poses(), simulator.poses(), atol=2e-3)
        np.testing.assert_allclose(shown.goal(), simulator.goal(), atol=1e-6)
        assert shown.outcome().reward == pytest.approx(outcome.reward, abs=0.02)
    simulator.close()
    other.close()


def test_a_world_that_ended_stays(double):
    worlds = WarpWorlds(arm(), 2)
    worlds.reset([0, 1])
    before = worlds.poses()
    worlds.end(0)
    worlds.step(np.ones((2, 2)))
    np.testing.assert_array_equal(worlds.poses()[0], before[0])
    assert np.abs(worlds.poses()[1] - before[1]).max() > 1e-3


def test_a_world_that_diverges_is_an_error_that_names_it(double):
    simulator = arm()
    worlds = WarpWorlds(simulator, 2)
    worlds.reset([0, 1])
    worlds.view(1).data.qvel[0] = 1e12
    worlds.keep(1)
    with pytest.raises(PwmGymError, match=r"world 1 diverged|world 1 has no room"):
        worlds.step(np.zeros((2, 2)))


def test_contacts_without_room_are_an_error(double):
    worlds = WarpWorlds(arm(), 1, contacts=1)
    worlds.reset([0])
    with pytest.raises(PwmGymError, match=r"world 0 has no room for its contacts: contacts=1"):
        for _ in range(5):
            worlds.step(np.zeros((1, 2)))


def test_numbers_that_do_not_fit_are_errors(double):
    worlds = WarpWorlds(arm(), 2)
    with pytest.raises(PwmGymError, match=r"3 seeds; expected one for each of 2 worlds"):
        worlds.reset([0, 1, 2])
    with pytest.raises(PwmGymError, match=r"shape \(2, 3\); expected \(2, 2\)"):
        worlds.step(np.zeros((2, 3)))
    with pytest.raises(PwmGymError, match=r"worlds=0"):
        WarpWorlds(arm(), 0)


def test_without_the_package_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    with pytest.raises(PwmGymError, match=r"pip install 'pwm-gym\[warp\]'"):
        WarpWorlds(arm(), 2)


def test_simulators_that_cannot_are_errors_that_name_them(double):
    with pytest.raises(PwmGymError, match=r"a SimpleNamespace; expected a MujocoSimulator"):
        WarpWorlds(SimpleNamespace(), 2)
    simulator = arm()
    simulator.world = SimpleNamespace(model=simulator.model, data=simulator.data)
    with pytest.raises(PwmGymError, match=r"SimpleNamespace steps its model itself"):
        WarpWorlds(simulator, 2)


@pytest.mark.slow  # the kernels of a model are compiled once a machine: two minutes on a CPU
def test_warp_pushes_a_box_as_mujoco_does():
    pytest.importorskip("mujoco_warp")
    seeds = [1, 2, 5]
    poses, joints = push(arm(), seeds)
    found, turned = push_in_worlds(WarpWorlds(arm(), 3, "cpu"), seeds)
    np.testing.assert_allclose(found, poses, atol=1e-4)  # metres
    np.testing.assert_allclose(turned, joints, atol=1e-4)


@pytest.mark.slow
def test_warp_moves_the_fetch_as_mujoco_does():
    pytest.importorskip("mujoco_warp")
    simulator = get_task("FetchPush").make_simulator()
    worlds = WarpWorlds(get_task("FetchPush").make_simulator(), 2, "cpu")
    worlds.reset([3, 4])
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2, 4))
    for action in actions:
        worlds.step(action)
    found = worlds.poses()
    for world, seed in enumerate([3, 4]):
        simulator.reset(seed)
        start = simulator.poses()
        for action in actions[:, world]:
            simulator.step(action)
        assert np.linalg.norm(simulator.poses()[0, :3] - start[0, :3]) > 0.01
        np.testing.assert_allclose(found[world, :3], simulator.poses()[:3], atol=1e-3)  # hand and fingers, metres
