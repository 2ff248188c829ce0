"""Thinner clouds; `python benchmarks/thinning.py` measures whole tasks."""

import json

import numpy as np
from thinning import Thinning, measure

from pwm_gym.tasks import get_task


def test_a_whole_cloud_differs_from_itself_by_nothing_and_a_thinner_one_by_a_little(tmp_path):
    whole = get_task("PickCube").layout.points
    Thinning("PickCube", shares=(1.0, 0.1), envs=2, steps=3, json=tmp_path / "thin.json").run()
    rows = json.loads((tmp_path / "thin.json").read_text())["rows"]
    assert rows[str(whole)]["reward_difference_most"] == rows[str(whole)]["entity_difference_mm"] == 0.0
    assert 0.0 < rows[str(whole // 10)]["reward_difference_most"] < 0.1


def test_steps_are_those_of_the_seed():
    one, other = (measure("PickCube", 120, 2, 2) for _ in range(2))
    assert np.array_equal(one["rewards"], other["rewards"]) and one["rewards"].shape == (2, 2)
