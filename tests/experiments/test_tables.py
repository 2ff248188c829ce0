import json
from dataclasses import replace

import pytest

from pwm_gym.dynamics import build_model
from pwm_gym.errors import DatasetError, PwmGymError, UnknownNameError
from pwm_gym.experiments import TABLES, run_table, tables
from pwm_gym.experiments.tables import Row, Table
from pwm_gym.tasks import get_task
from pwm_gym.training.losses import TrainConfig

TINY = {"points": 8, "point_width": 8, "width": 16, "blocks": 1, "kinematic": False, "uncertain": False}
QUICK = TrainConfig(phases=((1, 2, 8),), threads=1)


@pytest.fixture
def tiny(monkeypatch):
    row = Row("One", settings=TINY, training=QUICK, seeds=(0, 1), paper="0.009")
    monkeypatch.setitem(TABLES, "tiny", Table("A tiny table", (row,)))
    return row


def test_a_table_has_each_row_with_its_seeds_and_goes_on_where_it_was(tiny, data_folder, tmp_path):
    table = run_table("tiny", data_folder, tmp_path)
    (row,) = table["rows"]
    assert (table["caption"], row["row"], row["seeds"], row["paper, other data"]) == ("A tiny table", "One", 2, "0.009")
    assert row["sample_steps"] == 16 and row["parameters"] > 100 and row["episodes"] == 8
    assert row["splits"]["all"]["chamfer_l1"]["mean"] > 0
    results = {json.loads(p.read_text())["seed"]: p for p in tmp_path.glob("compact-*/result.json")}
    assert set(results) == {0, 1}
    result = results[1]
    kept = json.loads(result.read_text())
    kept["splits"]["all"]["chamfer_l1"], kept["commit"] = 1.0, "0ld"
    result.write_text(json.dumps(kept))
    results[0].unlink()
    again = run_table("tiny", data_folder, tmp_path)["rows"][0]
    first = row["splits"]["all"]["chamfer_l1"]["mean"] * 2 - kept["splits"]["all"]["chamfer_l1"]
    assert first < 1.0 < again["splits"]["all"]["chamfer_l1"]["mean"] * 2
    assert again["commits"] == sorted({"0ld", *row["commits"]})  # each piece tells which code made it


def test_a_changed_row_is_trained_anew(tiny, data_folder, tmp_path, monkeypatch):
    one = replace(tiny, seeds=(0,))
    monkeypatch.setitem(TABLES, "one", Table("", (one,)))
    monkeypatch.setitem(TABLES, "same", Table("", (replace(one, name="Another name"),)))
    monkeypatch.setitem(TABLES, "other", Table("", (replace(one, episodes=4),)))
    counts = []
    for table in ("one", "same", "other"):
        run_table(table, data_folder, tmp_path)
        counts.append(len(list(tmp_path.glob("*/result.json"))))
    assert counts == [1, 1, 2]


def test_rows_scale_and_seeds_choose_a_part_of_a_table(tiny, data_folder, tmp_path, monkeypatch):
    monkeypatch.setitem(TABLES, "two", Table("", (tiny, replace(tiny, name="Two", episodes=4))))
    (row,) = run_table("two", data_folder, tmp_path, rows=["Two"], scale=0.5, seeds=1)["rows"]
    assert (row["row"], row["seeds"], row["sample_steps"], row["episodes"]) == ("Two", 1, 8, 4)
    with pytest.raises(UnknownNameError, match="unknown row of the table 'Too'"):
        run_table("two", data_folder, tmp_path, rows=["Too"])


def test_a_shortened_row_is_another_piece(tiny, tmp_path):
    folders = {tables._piece(tiny.shorten(scale), 0, tmp_path, tmp_path, "PickCube").folder for scale in (1.0, 0.5)}
    assert len(folders) == 2
    assert tiny.shorten(1e-6).training.phases == ((1, 1, 8),)  # at least one step


def test_planned_rows_have_the_objects_asked_for(tiny, data_folder, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(tables, "check_objects", lambda task, objects: None)
    monkeypatch.setattr(tables, "plan_episodes", lambda agent, episodes, objects: asked.append(objects))
    monkeypatch.setitem(TABLES, "plans", Table("", (replace(tiny, seeds=(0,), plan=1), replace(tiny, seeds=(1,)))))
    for objects in ("", "unseen"):
        run_table("plans", data_folder, tmp_path, objects=objects)
    assert asked == ["", "unseen"]
    assert len(list(tmp_path.glob("*/result.json"))) == 3  # what plans nothing has no objects


def test_objects_that_a_task_has_not_are_refused_before_any_training(tiny, data_folder, tmp_path):
    with pytest.raises(PwmGymError, match="objects='unseen'; the objects of PickCube are always the same"):
        run_table("tiny", data_folder, tmp_path, objects="unseen")
    assert not list(tmp_path.iterdir())


def test_rows_of_a_table_have_one_budget():
    for table in TABLES.values():
        budgets = [sum(h * n * b for h, n, b in row.training.phases) for row in table.rows]
        assert max(budgets) < 1.01 * min(budgets)
        names = [row.name for row in table.rows]
        assert len(set(names)) == len(names)


def test_every_row_names_a_model_with_its_settings():
    task = get_task("PickCube")
    for row in (row for table in TABLES.values() for row in table.rows):
        model = build_model(row.model, task.layout, task.control, dict(row.settings))
        assert {k: getattr(model.config, k) for k in row.settings} == row.settings
        assert getattr(model, "error", None) is None  # nothing that stays unfitted


def test_unknown_tables_and_too_many_episodes_are_named(tiny, data_folder, tmp_path, monkeypatch):
    with pytest.raises(UnknownNameError, match=r"unknown table 'horizn'.*Did you mean 'horizon'"):
        run_table("horizn", data_folder, tmp_path)
    monkeypatch.setitem(TABLES, "many", Table("", (replace(tiny, name="Many", episodes=99),)))
    with pytest.raises(DatasetError, match="episodes=99; the data has 8"):
        run_table("many", data_folder, tmp_path)
