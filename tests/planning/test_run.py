from dataclasses import fields, replace

import numpy as np
import pytest

from pwm_gym.errors import PwmGymError
from pwm_gym.planning import Run


@pytest.fixture
def run(scene):
    rng = np.random.default_rng(0)
    return Run(
        start=scene,
        seed=300_100,
        success=True,
        actions=rng.uniform(-1, 1, (5, 7)).astype(np.float32),
        rewards=rng.random(5),
        plan_seconds=rng.random(5),
        poses=np.repeat(scene.poses[:1], 6, 0) + rng.random((6, 1, 1)),
        predicted=np.repeat(scene.poses[:1], 5, 0),
        predicted_rewards=rng.random(5),
        terms={"approach": rng.random(5), "carry": rng.random(5)},
        predicted_terms={"approach": rng.random(5), "carry": rng.random(5)},
        chunk=20,
        settings={"planner": "MPPI", "caution": 0.5},
    )


def test_a_saved_run_loads_as_it_was(run, tmp_path):
    run.save(tmp_path / "run.npz")
    again = Run.load(tmp_path / "run.npz")
    for name in (f.name for f in fields(run) if f.name != "start"):
        np.testing.assert_equal(getattr(again, name), getattr(run, name))
    for name in ("task", "layout", "clouds", "poses", "goal", "joints", "last_action"):
        np.testing.assert_equal(getattr(again.start, name), getattr(run.start, name))


def test_a_run_without_terms_loads_too(run, tmp_path):
    replace(run, terms={}, predicted_terms={}).save(tmp_path / "run.npz")
    assert Run.load(tmp_path / "run.npz").terms == {}


@pytest.mark.parametrize("kept", [0, 100, 2000])
def test_a_truncated_file_is_named(run, tmp_path, kept):
    path = tmp_path / "run.npz"
    run.save(path)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(PwmGymError, match=r"run.npz is not a run's file"):
        Run.load(path)


def test_another_kind_of_file_is_named(scene, tmp_path):
    scene.save(tmp_path / "scene.npz")
    with pytest.raises(PwmGymError, match=r"format 'pwm_gym.scene'; expected 'pwm_gym.run'"):
        Run.load(tmp_path / "scene.npz")


@pytest.mark.parametrize("name", ["rewards", "plan_seconds", "poses", "predicted", "predicted_rewards"])
def test_arrays_that_do_not_fit_are_named(run, name):
    with pytest.raises(PwmGymError, match=rf"run.{name} has shape .* expected"):
        replace(run, **{name: getattr(run, name)[:-1]})


def test_terms_are_of_both_worlds_and_keep_their_names(run, tmp_path):
    swapped = dict(reversed(run.predicted_terms.items()))
    replace(run, predicted_terms=swapped, seed=np.int64(5), success=np.bool_(True)).save(tmp_path / "run.npz")
    again = Run.load(tmp_path / "run.npz")
    assert again.seed == 5 and again.success is True
    np.testing.assert_equal(again.predicted_terms, run.predicted_terms)
    with pytest.raises(PwmGymError, match="cost term carry of real or of predicted states alone"):
        replace(run, predicted_terms={"approach": run.predicted_terms["approach"]})


def test_a_term_that_does_not_fit_is_named(run):
    with pytest.raises(PwmGymError, match=r"cost term 'carry' has shape \(4,\); expected \(5,\)"):
        replace(run, terms={**run.terms, "carry": np.zeros(4)})
