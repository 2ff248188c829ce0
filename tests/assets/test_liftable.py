import json

import pytest

from pwm_gym.assets import YCB_OBJECTS, is_unseen, liftable
from pwm_gym.errors import PwmGymError


def test_the_record_agrees_with_itself():
    record = liftable.liftable_record()
    rows = record["objects"]
    assert set(rows) <= set(YCB_OBJECTS) and len(rows) == 58
    for name, row in rows.items():
        assert len(row["steps"]) == record["settings"]["tries"]
        assert row["successes"] == sum(step is not None for step in row["steps"])
        assert (row["split"] == "unseen") == is_unseen(name)
    assert record["summary"] == liftable._summary(rows)


def test_most_objects_can_be_lifted_and_wide_ones_cannot():
    found = liftable.liftable_objects()
    assert "003_cracker_box" in found and "036_wood_block" not in found
    assert set(liftable.liftable_objects(5)) < set(found)
    assert sum(is_unseen(name) for name in found) == 8
    summary = liftable.liftable_record()["summary"]
    assert summary["liftable"] > 0.75 * summary["objects"] and summary["success_of_liftable"] > 0.9


class _Trials:
    def __init__(self, folder):
        self.tried = []

    def steps(self, name, seed, expert, limit):
        return 30 + seed % 100 if name == "shape_box" else None

    def close(self):
        pass


def test_a_run_goes_on_where_it_was_and_hides_no_failure(shapes, tmp_path, monkeypatch):
    monkeypatch.setattr(liftable, "YcbTrials", _Trials)
    monkeypatch.setattr(liftable, "object_grasps", lambda folder, name: None)
    out = tmp_path / "record.json"
    liftable.measure_liftable(shapes, out, ["shape_box"], tries=2)
    record = liftable.measure_liftable(shapes, out, ["shape_box", "shape_jar"], tries=2)
    assert json.loads(out.read_text()) == record
    assert record["objects"]["shape_jar"] == {"split": "seen", "successes": 0, "steps": [None, None]}
    assert record["summary"]["mean_steps"] == 30.5 and record["summary"]["liftable"] == 1
    with pytest.raises(PwmGymError, match="was measured with"):
        liftable.measure_liftable(shapes, out, tries=3)
