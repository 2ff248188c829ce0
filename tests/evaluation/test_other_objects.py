"""Objects that a task's simulator would not draw by default: as those that are kept out of training."""

from dataclasses import replace

import numpy as np
import pytest

from pwm_gym.commands.evaluate import Evaluate, _completed_starts
from pwm_gym.data import load_split
from pwm_gym.data.partial import visible_split
from pwm_gym.data.simulated import SceneMeshes, simulator_of
from pwm_gym.evaluation.long import mixed_episodes
from pwm_gym.tasks import get_task

TASK = get_task("PickYCB")
OBJECT = TASK.layout.index("object")


@pytest.fixture(scope="module")
def dataset(bars):
    return load_split(bars, "test", "PickYCB")


def test_the_floors_are_of_the_episodes_own_objects(dataset, cut):
    """Their simulator is a new one, whose seeds draw any of twelve shapes by default."""
    short = replace(dataset, episodes=tuple(cut(e, 12) for e in dataset.episodes))
    floors = Evaluate(task="PickYCB")._floors(TASK, short)
    assert 0.001 < floors["sampling, practice"]["chamfer_l1"] < 0.006
    chaos = floors["chaos, practice"]
    assert chaos["chamfer_l1"] < 0.005 and chaos["objects"]["object"]["position_mm"]["10"]["mean"] < 5


def test_long_episodes_have_them(dataset):
    simulator = simulator_of(TASK, dataset)
    long = mixed_episodes(simulator, TASK, dataset, count=2, steps=5, progress=False)
    simulator.close()
    assert {episode.assets[OBJECT] for episode in long.episodes} == {"shape_bar"}


def test_their_meshes_are_asked_for_once(dataset):
    simulator = simulator_of(TASK, dataset)
    meshes = SceneMeshes(simulator)
    first, second = (meshes(dataset.scene(episode)) for episode in dataset.episodes)
    simulator.close()
    assert first is second and max(first["object"].extents) == pytest.approx(0.14, abs=1e-3)


def test_a_camera_sees_them(dataset, bars):
    share = visible_split(bars, "test", TASK, dataset)[:, TASK.layout["object"].slice].mean()
    assert 0.3 < share < 0.7


def test_perception_completes_them(dataset):
    for start in _completed_starts(TASK, dataset, "hull", "ideal").values():
        cloud = start.clouds[0, TASK.layout["object"].slice].numpy()
        assert 0.08 < np.ptp(cloud, axis=0).max() < 0.16
