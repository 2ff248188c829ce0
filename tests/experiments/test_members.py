import json
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest
import torch
from PIL import Image

from pwm_gym.commands.failures import draw_failures
from pwm_gym.data.partial import PARTIAL_POINTS, PartialView
from pwm_gym.dynamics import rollout
from pwm_gym.envs import CameraConfig
from pwm_gym.errors import UnknownNameError
from pwm_gym.experiments import TABLES
from pwm_gym.experiments import members as table
from pwm_gym.experiments.members import PLANNING_TABLES, Member, PlanningTable, run_planning_table
from pwm_gym.planning import Agent, CEMConfig, MPPIConfig, Run, execute
from pwm_gym.scene import batch_state
from pwm_gym.sim.model import SimulatorModel
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
BASELINE = Member("linear", "baseline", "linear", slow=True, samples=4, partial=True)
TABLE = PlanningTable("one baseline", (BASELINE,), modes=("closed loop", "open loop"))


@pytest.fixture
def quick(monkeypatch):
    """One episode of two steps, few samples."""
    monkeypatch.setattr(table, "_SLOW_EPISODES", 1)
    monkeypatch.setattr(table, "_SLOW_SHARE", 0.02)
    monkeypatch.setattr(table, "get_planner_config", lambda name: MPPIConfig(samples=8, elites=4, horizon=2))


def test_a_table_tells_every_mode_and_keeps_what_is_there(quick, data_folder, tmp_path, monkeypatch):
    first = run_planning_table(TABLE, data_folder, tmp_path)
    (row,) = first["rows"]
    assert (
        row["row"] == "linear"
        and row["partial"]
        and row["samples"] == 4
        and set(row["modes"]) == {"closed loop", "open loop"}
    )
    assert all(mode["episodes"] == 1 and mode["runs"][0]["steps"] == 2 for mode in row["modes"].values())
    failed = [Run.load(p) for p in tmp_path.rglob("seed-*.npz")]
    assert sorted(run.chunk for run in failed) == [0, 1]
    assert "picture" not in row["modes"]["open loop"]
    monkeypatch.setattr(table, "_planned", lambda *a: pytest.fail("made again"))  # nothing is to be run
    assert run_planning_table(TABLE, data_folder, tmp_path) == first
    (row,) = run_planning_table(TABLE, data_folder, tmp_path, modes=["open loop"])["rows"]
    assert row["modes"] == {"open loop": first["rows"][0]["modes"]["open loop"]}
    with pytest.raises(UnknownNameError, match="unknown mode 'open'"):
        run_planning_table(TABLE, data_folder, tmp_path, modes=["open"])
    json.dumps(first)
    drawn = run_planning_table(TABLE, data_folder, tmp_path, draw=partial(draw_failures, tmp_path / "pictures"))
    names = [mode["picture"] for mode in drawn["rows"][0]["modes"].values()]
    assert names == ["failures/linear-closed-loop.png", "failures/linear-open-loop.png"]
    for name in names:
        with Image.open(tmp_path / "pictures" / name) as sheet:
            assert sheet.width > 500 and sheet.height > 150


def test_other_settings_are_another_piece(quick, data_folder, tmp_path, monkeypatch):
    run_planning_table(TABLE, data_folder, tmp_path)
    monkeypatch.setattr(table, "_SLOW_SHARE", 0.01)
    (row,) = run_planning_table(TABLE, data_folder, tmp_path)["rows"]
    assert row["modes"]["open loop"]["runs"][0]["steps"] == 1


def test_members_are_chosen_by_name():
    planning = PLANNING_TABLES["planning"]
    assert planning.choose() == planning.members
    assert [m.name for m in planning.choose(["Partial 3DPWM"])] == ["Partial 3DPWM"]
    with pytest.raises(UnknownNameError, match=r"unknown member of the table 'Partial'; known: .*3DPWM"):
        planning.choose(["Partial"])


def test_the_papers_protocol_is_its_own():
    members = PLANNING_TABLES["planning-paper"].members
    assert {m.config(TASK) for m in members} == {MPPIConfig.paper()} and {m.count(full=True) for m in members} == {20}
    config = members[0].config(TASK)
    assert (config.samples, config.horizon, config.elites) == (200, 10, 64)
    assert set(config.noise.resolve(TASK.control).sigma) == {5.0}


def test_planners_are_compared_in_one_model():
    members = PLANNING_TABLES["planners"].members
    assert {(m.kind, m.source, m.slow) for m in members} == {("checkpoint", "default", False)}
    assert [type(m.config(TASK)) for m in members[:2]] == [MPPIConfig, CEMConfig]
    assert replace(members[0], samples=20).config(TASK) == members[0].config(TASK).resize(20)


def test_what_the_environment_shows_is_what_is_planned_from(data_folder, tmp_path, quick, monkeypatch):
    seen, original = {}, gymnasium.make

    def make(name, **settings):
        seen.update(settings)
        return original(name, **settings)

    monkeypatch.setattr(table.gym, "make", make)
    monkeypatch.setattr(table, "digest", lambda folder: "weights")
    monkeypatch.setattr("pwm_gym.envs.CameraConfig", lambda sensor: CameraConfig(sensor=sensor, completer="hull"))
    member = replace(BASELINE, partial=False, observation="completed", sensor="d455")
    chosen = PlanningTable("completed", (member,), modes=("closed loop",))
    run_planning_table(chosen, data_folder, tmp_path)
    assert seen["observation"] == "completed" and seen["camera"].sensor == "d455"
    (run,) = [Run.load(p) for p in tmp_path.rglob("seed-*.npz")]
    assert run.steps == 2


def test_a_piece_is_named_after_all_that_decides_it(tmp_path, monkeypatch):
    def name(member, data="a", objects=""):
        piece = table._piece(member, "closed loop", tmp_path / data, tmp_path, "PickCube", False, objects)
        return piece.folder.name

    row, shipped = Member("x", "row", "3DPWM, paper-small"), Member("x", "checkpoint", "default")
    before = name(row)
    assert name(shipped) != name(replace(shipped, planner="cem")) and name(shipped) == name(replace(shipped, name="y"))
    assert len({name(shipped, objects=x) for x in ("", "seen", "unseen")}) == 3
    assert name(BASELINE) != name(BASELINE, "b") and name(shipped) == name(shipped, "b")
    rows = [replace(r, episodes=7) for r in TABLES["rollout"].rows]
    monkeypatch.setitem(TABLES, "rollout", replace(TABLES["rollout"], rows=tuple(rows)))
    assert name(row) != before


def test_every_member_plans_with_the_objects_asked_for(quick, bars, tmp_path):
    members = (BASELINE, Member("itself", "simulator", "", slow=True, samples=4))
    chosen = PlanningTable("objects", members, modes=("open loop",))
    run_planning_table(chosen, bars, tmp_path, "PickYCB", objects="shape_ball")
    runs = [Run.load(p) for p in tmp_path.rglob("seed-*.npz")]
    assert [run.start.assets[3] for run in runs] == ["shape_ball"] * 2
    assert sum(np.allclose(run.predicted, run.poses[1:], atol=1e-3) for run in runs) == 1  # the simulator's own
    with pytest.raises(UnknownNameError, match="unknown object or set of objects 'shape_bal'.*'shape_ball'"):
        run_planning_table(chosen, bars, tmp_path, "PickYCB", objects="shape_bal")


def test_the_simulator_as_a_model_is_the_simulator(sim, random_actions):
    """A rollout agrees with the twin's own steps, and a planner can begin anywhere."""
    sim.reset(seed=300_000)
    model = SimulatorModel(TASK.simulator(), TASK.layout, TASK.name, TASK.goal_size)
    actions = 0.3 * random_actions(0, 2, 5, 7)
    start = sim.unwrapped.scene()
    states = rollout(model, batch_state([start] * 2), torch.as_tensor(actions))
    assert states.frames.shape == (2, 5, 3, 4, 4, 4) and states.joints.shape == (2, 5, 2, 9)
    for b in range(2):
        sim.reset(options={"scene": start})
        for k in range(5):
            sim.step(actions[b, k])
        truth = batch_state([sim.unwrapped.scene()])
        assert (states[:, -1].poses()[b] - truth.poses()[0]).abs().max() < 1e-3
        assert (states[:, -1].joints[b] - truth.joints[0]).abs().max() < 1e-3


def test_the_simulator_is_planned_in_and_advanced(sim):
    """Planning runs in inference mode, what follows does not."""
    model = SimulatorModel(TASK.simulator(), TASK.layout, TASK.name, TASK.goal_size)
    run = execute(sim, Agent(model, TASK.name, MPPIConfig(samples=4, elites=2, horizon=2)), 300_000, 3)
    np.testing.assert_allclose(run.predicted, run.poses[1:], atol=1e-3)


def test_a_partial_view_shows_what_faces_the_camera(sim):
    sim.reset(seed=300_000)
    scene = sim.unwrapped.scene()
    view = PartialView(sim.unwrapped.simulator.meshes(), TASK.layout)
    seen = view(scene)
    np.testing.assert_array_equal(view(scene).clouds, seen.clouds)
    assert all(e.points == PARTIAL_POINTS for e in seen.layout)
    np.testing.assert_array_equal(seen.poses, scene.poses)
    whole = {tuple(p) for p in scene.clouds}
    assert {tuple(p) for p in seen.clouds} <= whole
    assert len({tuple(p) for p in seen.clouds}) < len(whole) / 3
    cube, full = (batch_state([s]).entity("cube")[0] for s in (seen, scene))
    assert cube[:, 2].mean() > full[:, 2].mean() + 0.003  # the top is seen, the bottom is not
