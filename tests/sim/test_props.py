"""Further bodies in the simulator's scenes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pwm_gym.errors import SceneError, UnknownNameError
from pwm_gym.experiments import distractors
from pwm_gym.experiments.distractors import DISTRACTORS, add_distractors, plan_among_distractors
from pwm_gym.sim.props import PROPS, Prop, get_prop, register_prop
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
OWN = len(TASK.layout)
REST = np.array([0, 0, 0, 0, 0, 0, 1], np.float32)


@pytest.fixture
def crowded(sim):
    """A scene of the simulator with five distractors."""
    sim.reset(seed=3)
    return add_distractors(sim.unwrapped.scene(), "cube", 3)


def test_they_stand_where_the_scene_says_and_stay(sim, crowded):
    env = sim.unwrapped
    observation, _ = env.reset(options={"scene": crowded})
    assert observation in env.observation_space  # of the task's own entities
    assert env.scene().layout == crowded.layout and env.scene().assets == crowded.assets
    for _ in range(5):
        env.step(REST)
    np.testing.assert_allclose(env.scene().poses[0, OWN:, :3], crowded.poses[0, OWN:, :3], atol=1e-4)
    env.simulator.place("distractor_can", np.array([0.5, 0.3, 0.3, 1, 0, 0, 0]))
    env.step(REST)
    assert env.scene().poses[0, crowded.layout.index("distractor_can"), 2] < 0.299  # it is a body and falls


def test_their_surfaces_are_those_of_their_shapes(sim, crowded):
    sim.reset(options={"scene": crowded})
    meshes = sim.unwrapped.simulator.meshes()
    for prop in DISTRACTORS:
        np.testing.assert_allclose(meshes[prop.name].bounds, prop.mesh().bounds, atol=1e-5)
        assert prop.mesh().bounds[1, 2] == pytest.approx(prop.half_height)
        reach = np.linalg.norm(prop.mesh().vertices[:, :2], axis=1).max()
        assert reach == pytest.approx(prop.radius, abs=1e-6)


def test_an_episode_without_them_follows_as_if_they_had_never_been(sim, crowded):
    env = sim.unwrapped
    plain = [env.reset(seed=5)[0]["points"], env.step(REST)[0]["points"]]
    env.reset(options={"scene": crowded})
    moved = env.scene(truth=True)
    env.reset(options={"scene": moved})
    np.testing.assert_allclose(env.simulator.poses()[:, :3], moved.poses[0, :, :3], atol=1e-5)
    again = [env.reset(seed=5)[0]["points"], env.step(REST)[0]["points"]]
    np.testing.assert_array_equal(plain, again)
    assert env.scene().layout == TASK.layout


def test_a_body_may_have_another_name_than_its_shape(sim, crowded):
    entities = [*crowded.layout.entities]
    entities[-1] = replace(entities[-1], name="second_can")
    layout = replace(crowded.layout, entities=tuple(entities))
    scene = replace(crowded, layout=layout, assets=(*crowded.assets[:-1], "distractor_can"))
    sim.reset(options={"scene": scene})
    assert sim.unwrapped.simulator.assets() == scene.assets
    assert sim.unwrapped.scene().layout.names[-1] == "second_can"


def test_what_is_no_known_shape_or_not_free_is_refused(sim, crowded):
    with pytest.raises(UnknownNameError, match="unknown prop 'distractor_cup'.*Did you mean 'distractor_cube'"):
        sim.reset(options={"scene": replace(crowded, assets=(*crowded.assets[:-1], "distractor_cup"))})
    driven = replace(crowded.layout.entities[-1], driven=True)
    layout = replace(crowded.layout, entities=(*crowded.layout.entities[:-1], driven))
    with pytest.raises(SceneError, match="further entities distractor_cube are not free"):
        sim.unwrapped.simulator.restore(replace(crowded, layout=layout))


def test_a_shapes_name_is_taken_once():
    assert get_prop("distractor_can") is PROPS["distractor_can"]
    with pytest.raises(ValueError, match="'distractor_can' is registered already"):
        register_prop(Prop("distractor_can", "box", (0.1, 0.1, 0.1)))


class Sweeper:
    """Stands in for an agent: lowers the open hand."""

    task = TASK

    def __init__(self, *_):
        self.seen = []

    def reset(self, seed):
        pass

    def act(self, scene):
        self.seen.append(scene)
        return np.array([0, 0, -1, 0, 0, 0, 1], np.float32)


def test_planning_among_distractors_runs_in_the_simulator(simulator, crowded):
    agent = Sweeper()
    table = plan_among_distractors(agent, [crowded], simulator, max_steps=3)
    assert table["episodes"] == 1 and table["successes"] == 0
    assert table["distractors_pushed_mm"]["largest"] < 1.0
    assert [scene.layout.names for scene in agent.seen] == [crowded.layout.names] * 3
    assert agent.seen[-1].poses[0, 0, 2] < crowded.poses[0, 0, 2] - 0.005  # it sees its hand come down


def test_the_table_plans_in_the_tasks_own_simulator(simulator, crowded, monkeypatch):
    plain = replace(
        crowded,
        layout=TASK.layout,
        clouds=crowded.clouds[: TASK.layout.points],
        poses=crowded.poses[:, :OWN],
        assets=(),
    )
    bank = type("Bank", (), {"__len__": lambda self: 1, "scene": lambda self, k: plain})()
    checkpoint = SimpleNamespace(model=None, bank=lambda task: bank)
    task = replace(TASK, max_episode_steps=3, simulator=lambda: simulator)
    monkeypatch.setattr(simulator, "close", lambda: None)
    monkeypatch.setattr(distractors, "Agent", Sweeper)
    monkeypatch.setattr(distractors, "distractor_influence", lambda *_: {})
    assert distractors.run_distractor_table(checkpoint, task, episodes=1)["planning"]["episodes"] == 1
    assert distractors.run_distractor_table(checkpoint, task, episodes=1, plan=False)["planning"] is None
