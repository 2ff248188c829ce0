from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from pwm_gym.data import Dataset, Episode
from pwm_gym.data.minari_format import export_minari, import_minari
from pwm_gym.errors import DatasetError
from pwm_gym.tasks import get_task


def _episode(seed: int, steps: int) -> Episode:
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(steps + 1, 4, 7)).astype(np.float32)
    return Episode(
        poses=poses,
        joints=rng.normal(size=(steps + 1, 2, 9)).astype(np.float32),
        actions=rng.uniform(-1, 1, (steps, 7)).astype(np.float32),
        rewards=rng.uniform(0, 1, steps).astype(np.float32),
        success=np.arange(steps) == steps - 1,
        grasped=rng.uniform(size=steps) < 0.5,
        goal=rng.normal(size=3).astype(np.float32),
        kind=seed % 4,
        seed=seed,
        switch=seed - 1,
    )


def test_export_and_import_give_the_same_episodes(tmp_path, monkeypatch):
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    task = get_task("PickCube")
    assets = {e.name: np.zeros((e.points, 3), np.float32) for e in task.layout}
    original = Dataset(task.name, task.layout, assets, (_episode(0, 5), _episode(1, 8)))
    export_minari(original, "pwm/PickCube/test-v0")
    back = import_minari("pwm/PickCube/test-v0", task.name, assets)
    assert len(back.episodes) == 2
    for a, b in zip(original.episodes, back.episodes, strict=True):
        for field in fields(Episode):
            assert np.array_equal(getattr(a, field.name), getattr(b, field.name)), field.name


def test_objects_that_differ_between_episodes_are_refused(worlds, recorder):
    with pytest.raises(DatasetError, match="has 3 combinations of assets; expected the same objects in all episodes"):
        export_minari(recorder.several(worlds["cube"]), "pwm/Test/test-v0")
