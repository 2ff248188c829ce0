"""Collection in worlds that MuJoCo Warp steps."""

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import warp_double

from pwm_gym.collection import CollectConfig, collect
from pwm_gym.commands.collect import Collect
from pwm_gym.data import KINDS, load_split
from pwm_gym.errors import DatasetError, PwmGymError
from pwm_gym.tasks import get_task
from pwm_gym.tasks.registry import TASKS

CONFIG = CollectConfig("FetchReach", episodes=2, held_out=1, workers=1, shard=2, randomise=0.0)


def test_worlds_collect_what_the_simulator_does(tmp_path, monkeypatch):
    warp_double.install(monkeypatch)
    worlds = collect(replace(CONFIG, out=tmp_path / "worlds", warp=3), progress=False)
    plain = collect(replace(CONFIG, out=tmp_path / "plain"), progress=False)
    assert json.loads((worlds / "dataset.json").read_text())["settings"]["warp"] is True
    for split, kinds in (("train", {"expert": 1, "practice": 1}), ("test", {"expert": 1})):
        found, expected = load_split(worlds, split), load_split(plain, split)
        assert [e.seed for e in found.episodes] == [e.seed for e in expected.episodes]
        counted = [KINDS[e.kind] for e in found.episodes]
        assert {kind: counted.count(kind) for kind in {*counted}} == kinds
        for ours, theirs in zip(found.episodes, expected.episodes, strict=True):
            np.testing.assert_array_equal(ours.goal, theirs.goal)
            np.testing.assert_allclose(ours.poses[:2], theirs.poses[:2], atol=1e-4)
            if KINDS[ours.kind] == "expert":  # it puts right what rounding changes
                assert ours.success.any() and abs(len(ours) - len(theirs)) <= 1
                np.testing.assert_allclose(ours.rewards[-1], theirs.rewards[-1], atol=0.02)


def test_a_killed_run_goes_on_with_any_number_of_worlds(tmp_path, monkeypatch):
    warp_double.install(monkeypatch)
    config = replace(CONFIG, episodes=2, held_out=1, practice=0.0, out=tmp_path, warp=2)
    collect(config, progress=False)
    kept, lost = sorted(tmp_path.glob("*-demonstration-*.npz"))[:2]
    before, contents = kept.stat().st_mtime_ns, lost.read_bytes()
    lost.unlink()
    collect(replace(config, warp=1), progress=False)
    assert kept.stat().st_mtime_ns == before and lost.read_bytes() == contents
    with pytest.raises(DatasetError, match="'warp': True"):
        collect(replace(config, warp=0), progress=False)


def test_without_the_package_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    with pytest.raises(PwmGymError, match=r"pip install 'pwm-gym\[warp\]'"):
        collect(replace(CONFIG, out=tmp_path / "set", warp=2), progress=False)
    assert not (tmp_path / "set").exists()


def test_a_task_of_another_simulator_is_an_error(tmp_path, monkeypatch):
    warp_double.install(monkeypatch)
    other = replace(get_task("FetchReach"), name="Elsewhere", simulator=SimpleNamespace)
    monkeypatch.setitem(TASKS, "Elsewhere", other)
    with pytest.raises(PwmGymError, match="a SimpleNamespace; expected a MujocoSimulator"):
        collect(replace(CONFIG, task="Elsewhere", out=tmp_path / "set", warp=2), progress=False)
    assert not (tmp_path / "set").exists()


def test_what_does_not_go_together_is_an_error():
    with pytest.raises(DatasetError, match="warp=-1"):
        replace(CONFIG, warp=-1)
    with pytest.raises(DatasetError, match=r"warp=2 and on_policy=0\.1"):
        replace(CONFIG, warp=2, on_policy=0.1)
    with pytest.raises(PwmGymError, match="ray='local' and warp=2"):
        Collect(ray="local", config=replace(CONFIG, warp=2)).run()
