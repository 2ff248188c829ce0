from itertools import combinations

import numpy as np
import pytest

from pwm_gym.commands.evaluate import Evaluate
from pwm_gym.dynamics import build_model, load_checkpoint, resolve
from pwm_gym.errors import PwmGymError
from pwm_gym.experiments.distractors import (
    DISTRACTORS,
    add_distractors,
    distractor_influence,
    plan_among_distractors,
    run_distractor_table,
)
from pwm_gym.planning import Agent, MPPIConfig
from pwm_gym.scene import batch_state
from pwm_gym.sim import SimOutcome
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")


@pytest.fixture(scope="module")
def scenes():
    bank = load_checkpoint(resolve("default", "PickCube")).bank("PickCube")
    return [bank.scene(i) for i in range(20)]


def test_distractors_stand_around_the_cube(scenes):
    for seed, scene in enumerate(scenes):
        made = add_distractors(scene, "cube", seed)
        assert made.layout.names == (*scene.layout.names, *(d.name for d in DISTRACTORS))
        made.validate("PickCube", made.layout, len(scene.goal))
        points = batch_state([made]).points()[0].numpy()
        things = [points[made.layout[n].slice] for n in ("cube", *made.layout.names[4:])]
        centres = made.poses[0, 3:, :2]
        gaps = np.linalg.norm(centres[1:] - centres[0], axis=1)
        assert (gaps < 0.08).sum() >= 2 and gaps.max() < 0.22
        for thing in things:
            assert abs(thing[:, 2].min()) < 2e-3  # on the table
        for a, b in combinations(things, 2):
            assert np.linalg.norm(a[:, None, :2] - b[None, :, :2], axis=-1).min() > 0.004


def test_places_follow_the_seed(scenes):
    first, again, other = (add_distractors(scenes[0], "cube", s).poses for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


def test_too_many_distractors_are_refused(scenes, monkeypatch):
    with pytest.raises(PwmGymError, match="count=9, near=2; expected 0 <= near <= count <= 5"):
        add_distractors(scenes[0], "cube", 0, count=9)
    monkeypatch.setattr("pwm_gym.experiments.distractors._NEAR", 0.01)
    with pytest.raises(PwmGymError, match="no room for a distractor"):
        add_distractors(scenes[0], "cube", 0)


class Drift:
    """A model that moves every entity that is not the robot's by 1 mm a step, for each entity that is there."""

    action_size = 7

    def prepare(self, state):
        return state

    def step(self, state, action):
        poses = state.poses().clone()
        poses[:, 3:, 0, 3] += 1e-3 * len(state.layout)
        return state.advance(poses)


def test_a_task_without_objects_is_refused():
    checkpoint = load_checkpoint(resolve("default", "PickCube"))
    with pytest.raises(PwmGymError, match="FetchReach has no object for distractors to stand about"):
        run_distractor_table(checkpoint, get_task("FetchReach"))


def test_the_influence_of_distractors_is_measured(scenes):
    plain = scenes[:3]
    cluttered = [add_distractors(s, "cube", k) for k, s in enumerate(plain)]
    actions = np.zeros((3, 4, 7), np.float32)
    out = distractor_influence(Drift(), plain, cluttered, actions)
    assert out["own_mm"] == pytest.approx({"hand": 0, "left_gripper": 0, "right_gripper": 0, "cube": 4 * 5.0}, abs=1e-3)
    assert out["distractors_mm"]["mean"] == pytest.approx(4 * 9.0, abs=1e-3)


class World:
    """Succeeds after so many steps, and pushes the last distractor."""

    def __init__(self, after):
        self.after, self.steps = after, 0

    def restore(self, scene):
        self.scene, self.steps = scene, 0

    def step(self, action):
        assert action.shape == (7,)
        self.steps += 1
        return SimOutcome(0.0, self.steps >= self.after, False)

    def poses(self):
        poses = self.scene.poses[0].copy()
        poses[-1, 0] += 1e-3 * self.steps
        return poses

    def joints(self):
        return self.scene.joints


@pytest.mark.parametrize(("after", "wins"), [(2, 2), (9, 0)])
def test_planning_among_distractors_is_counted(scenes, after, wins):
    model = build_model("still", TASK.layout, TASK.control)
    agent = Agent(model, "PickCube", MPPIConfig(samples=4, elites=2, horizon=2))
    cluttered = [add_distractors(s, "cube", k) for k, s in enumerate(scenes[:2])]
    out = plan_among_distractors(agent, cluttered, World(after), max_steps=4)
    assert (out["episodes"], out["successes"]) == (2, wins)
    assert out["mean_steps_of_successes"] == (2.0 if wins else None)
    assert out["distractors_pushed_mm"]["largest"] == pytest.approx(2.0 if wins else 4.0, abs=1e-6)


def test_the_command_prints_what_the_table_tells(monkeypatch, capsys, tmp_path):
    planning = {"successes": 3, "distractors_pushed_mm": {"mean": 1.0, "largest": 2.0}}
    influence = {"own_mm": {"cube": 0.1}, "distractors_mm": {"mean": 0.0, "largest": 0.0}}

    def table(checkpoint, task, episodes):
        assert checkpoint.banks[task.name] and checkpoint.model is not None
        return {"episodes": episodes, "influence": influence, "planning": planning}

    monkeypatch.setattr("pwm_gym.experiments.run_distractor_table", table)
    Evaluate(table="distractors", episodes=3, threads=1, json=tmp_path / "table.json").run()
    assert "3 scenes" in capsys.readouterr().out and (tmp_path / "table.json").exists()
