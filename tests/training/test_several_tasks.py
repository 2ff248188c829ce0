"""Training on tiny synthetic data sets of several tasks of one robot."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.data import load_split
from pwm_gym.data.partial import visible_rows
from pwm_gym.dynamics import load_checkpoint
from pwm_gym.errors import DatasetError, PwmGymError, UnknownNameError
from pwm_gym.files import save_arrays
from pwm_gym.robots import Robot
from pwm_gym.robots.panda import PANDA
from pwm_gym.scene import batch_state
from pwm_gym.tasks.registry import TASKS, Task, get_task
from pwm_gym.training import FitConfig, fit
from pwm_gym.training.fit import joined, load_sources
from pwm_gym.training.losses import TrainConfig

SETTINGS = {"points": 8, "point_width": 8, "width": 16, "blocks": 1, "heads": 2, "arm_width": 8}
QUICK = TrainConfig(phases=((1, 6, 4), (2, 4, 4)), validate_every=5, threads=1)


def nothing(*_):
    raise AssertionError("training needs no simulator, expert or validation of this task")


@pytest.fixture
def register(monkeypatch):
    """``register(name, world, robot)``: a task of its own for a synthetic world."""

    def add(name, world, robot=PANDA):
        robot = replace(robot, control=world.control)
        task = Task(name, "", robot, world.layout, nothing, nothing, "none", "none", "none", "none")
        monkeypatch.setitem(TASKS, name, task)
        return task

    return add


@pytest.fixture
def folders(worlds, recorder, register, tmp_path):
    """Data sets of three tasks of the Panda: a cube of several assets, a drawer, and a lid without a goal."""
    sets = {
        "Cube": recorder.several(worlds["cube"], "Cube"),
        "Drawer": recorder.dataset(worlds["drawer"], "Drawer", goal=1),
        "Lid": recorder.dataset(worlds["lid"], "Lid", goal=0),
    }
    for name, dataset in sets.items():
        register(name, worlds[name.lower()])
        for split in ("train", "validation"):
            recorder.write(dataset, tmp_path / name, split)
    return {name: tmp_path / name for name in sets}


def config(out, *data, **changes):
    defaults = {"settings": SETTINGS, "arm_steps": 3, "error_steps": 3}
    return FitConfig(data=data, out=out, **{**defaults, **changes})


def count(model, dataset, seen):
    return {"episodes": float(len(dataset.episodes)), "entities": float(len(dataset.layout))}


def test_several_tasks_are_trained_into_one_checkpoint(folders, tmp_path):
    folder = fit(config(tmp_path / "run", *folders.values()), QUICK, count, progress=False)
    loaded = load_checkpoint(folder)
    assert loaded.tasks == tuple(loaded.banks) == ("Cube", "Drawer", "Lid")
    banks = loaded.banks
    assert [len(b) for b in banks.values()] == [6, 3, 3]
    assert banks["Cube"].clouds.shape == (3, 64, 3) and banks["Drawer"].clouds.shape == (1, 112, 3)
    assert [banks["Cube"].scene(k).assets[3] for k in (1, 2, 3)] == ["cube 1", "cube 2", "cube 0"]
    assert [b.goals.shape[1] for b in banks.values()] == [3, 1, 0]
    told = loaded.description["training"]["data"]
    assert told["tasks"] == {"Cube": 6, "Drawer": 3, "Lid": 3}
    assert told["joints"] == ["fixed", "free", "prismatic", "revolute"]
    metrics = loaded.description["metrics"]["validation"]
    assert metrics["Cube/episodes"] == 6 and metrics["Drawer/entities"] == 7 and len(metrics) == 6
    for bank in banks.values():
        state = loaded.model.prepare(batch_state([bank.scene(0), bank.scene(1)]))
        after = loaded.model.step(state, torch.zeros(2, 7))
        assert after.points().isfinite().all() and after.error.isfinite().all()


def test_every_task_changes_the_weights(folders, tmp_path):
    both = fit(config(tmp_path / "both", folders["Cube"], folders["Drawer"]), QUICK, count, progress=False)
    alone = fit(config(tmp_path / "alone", folders["Cube"]), QUICK, count, progress=False)
    a, b = (load_checkpoint(folder) for folder in (both, alone))
    weights = [c.model.state_dict()["movers.head.weight"] for c in (a, b)]
    assert weights[0].shape == weights[1].shape and not torch.equal(*weights)
    assert b.tasks == ("Cube",) and b.description["metrics"]["validation"] == {"episodes": 6.0, "entities": 4.0}


@pytest.mark.parametrize("name", ["four", "unknown arm", "two arms", "bolted hand"])
def test_every_kind_of_robot_is_trained(worlds, recorder, register, tmp_path, name):
    world = worlds[name]
    register("Own", world, Robot("own", {e.name: e.name for e in world.layout if e.driven}, world.control))
    dataset = recorder.dataset(world, "Own", goal=0)
    for split in ("train", "validation"):
        recorder.write(dataset, tmp_path / "data", split)
    quick = replace(QUICK, phases=((2, 2, 4),))
    loaded = load_checkpoint(fit(config(tmp_path / "run", tmp_path / "data"), quick, count, progress=False))
    assert loaded.model.control == world.control and loaded.model.links == world.layout.robot()
    assert len(loaded.bank("Own")) == 3


def test_episodes_are_shared_among_the_tasks(folders, tmp_path):
    quick = replace(QUICK, phases=((1, 1, 2),))
    folder = fit(config(tmp_path / "run", *folders.values(), episodes=6), quick, count, progress=False)
    assert load_checkpoint(folder).description["training"]["data"]["tasks"] == {"Cube": 2, "Drawer": 2, "Lid": 2}
    with pytest.raises(DatasetError, match="episodes=12; the data has 3 of task 'Drawer'"):
        fit(config(tmp_path / "more", *folders.values(), episodes=12), quick, count, progress=False)


def test_partial_clouds_of_chosen_episodes(folders, tmp_path):
    seen = {}
    for name, folder in folders.items():
        for split in ("train", "validation"):
            dataset = load_split(folder, split)
            frames = np.concatenate([np.full(len(e) + 1, k) for k, e in enumerate(dataset.episodes)])
            seen[name, split] = np.arange(dataset.layout.points) % len(dataset.episodes) == frames[:, None]
            save_arrays(folder / f"visible-{split}.npz", {"visible": np.packbits(seen[name, split], axis=1)})
    validated = []

    def validate(model, dataset, rows):
        validated.append(np.array_equal(rows, seen[dataset.task, "validation"]))
        return {"chamfer": 1.0}

    chosen = config(tmp_path / "run", *folders.values(), view="partial", episodes=6)
    trained = load_checkpoint(fit(chosen, QUICK, validate, progress=False))
    assert trained.description["training"]["data"]["view"] == "partial"
    assert validated and all(validated)
    whole = load_sources(chosen.folders, "train")[0]
    rows = visible_rows(chosen.folders, "train", whole, whole.some(2))
    ends = np.cumsum([len(e) + 1 for e in whole.episodes])
    wanted = np.concatenate([seen["Cube", "train"][: ends[0]], seen["Cube", "train"][ends[-2] :]])
    assert np.array_equal(rows, wanted)


# Sources


def test_data_sets_of_one_task_are_joined(folders, recorder, worlds, tmp_path):
    more = recorder.several(worlds["cube"], "Cube")
    extra = {"cube 9": more.assets["cube 0"] * 0.5}
    names = tuple("cube 9" if n == "cube" else n for n in more.layout.names)
    episode = replace(more.episodes[0], assets=names, seed=99)
    recorder.write(replace(more, assets={**more.assets, **extra}, episodes=(episode,)), tmp_path / "more")
    (found,) = load_sources([folders["Cube"], tmp_path / "more"], "train")
    assert [e.seed for e in found.episodes] == [0, 1, 2, 3, 4, 5, 99]
    np.testing.assert_array_equal(found.cloud(found.episodes[-1])[-16:], extra["cube 9"])
    sources = load_sources([folders["Cube"], folders["Lid"], tmp_path / "more"], "train")
    assert [(d.task, len(d.episodes)) for d in sources] == [("Cube", 7), ("Lid", 3)]


def test_assets_of_one_name_with_other_points_are_refused(folders, recorder, worlds):
    a = recorder.several(worlds["cube"], "Cube")
    b = replace(a, assets={**a.assets, "cube 1": a.assets["cube 2"]})
    with pytest.raises(DatasetError, match="two data sets of task 'Cube' have other canonical points of 'cube 1'"):
        joined(a, b)
    more = recorder.dataset(worlds["drawer"], "Cube")
    with pytest.raises(DatasetError, match="two data sets of task 'Cube' have other entities or numbers of points"):
        joined(a, more)


def test_data_sets_of_different_robots_are_refused(folders, recorder, worlds, register, tmp_path):
    register("Two", worlds["two arms"], Robot("twins", {}, worlds["two arms"].control))
    recorder.write(recorder.dataset(worlds["two arms"], "Two"), tmp_path / "two")
    with pytest.raises(DatasetError, match="'Two' has robot 'twins' and 'Cube' has 'panda'; expected data sets of one"):
        load_sources([folders["Cube"], tmp_path / "two"], "train")
    register("Four", worlds["four"], Robot("panda", {}, worlds["four"].control))  # the same links, but 4 components
    recorder.write(recorder.dataset(worlds["four"], "Four"), tmp_path / "four")
    with pytest.raises(DatasetError, match="expected data sets of one robot"):
        load_sources([folders["Cube"], tmp_path / "four"], "train")


def test_no_data_is_a_clear_error(folders, tmp_path):
    with pytest.raises(DatasetError, match="no folder was given; expected at least one data set"):
        load_sources([], "train")
    with pytest.raises(DatasetError, match="has no episodes of split 'test' yet"):
        load_sources([folders["Cube"]], "test")


def test_joints_of_a_kind_that_no_training_had_are_warned_of(folders, tmp_path):
    checkpoint = load_checkpoint(fit(config(tmp_path / "run", folders["Cube"]), QUICK, count, progress=False))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checkpoint.check_joints(get_task("Cube").layout)
    with pytest.warns(UserWarning, match=r"was trained without joints as of 'drawer' \(prismatic\)"):
        checkpoint.check_joints(get_task("Drawer").layout)


def test_training_goes_on_from_a_checkpoint(folders, tmp_path):
    first = fit(config(tmp_path / "first", folders["Cube"]), QUICK, count, progress=False)
    still = replace(QUICK, phases=((1, 1, 4),), learning_rate=0.0, weight_decay=0.0, ema_decay=0.0)
    begun = config(tmp_path / "second", folders["Drawer"], init=str(first), settings={}, error_steps=1)
    second = load_checkpoint(fit(begun, still, count, progress=False))
    old, new = load_checkpoint(first).model.state_dict(), second.model.state_dict()
    kept = [name for name in old if not name.startswith("error.")]
    assert all(torch.equal(old[name], new[name]) for name in kept)  # the fitted responses, too
    assert second.tasks == ("Drawer",) and second.description["training"]["init"] == str(first)
    assert second.seen_tasks == (*load_checkpoint(first).seen_tasks, "Drawer")
    assert second.seen_joints == ("fixed", "free", "prismatic")
    further = fit(replace(begun, out=tmp_path / "third"), QUICK, count, progress=False)
    assert not torch.equal(load_checkpoint(further).model.state_dict()["movers.head.weight"], old["movers.head.weight"])
    with pytest.raises(PwmGymError, match="beside init"):
        fit(replace(begun, settings={"width": 8}, out=tmp_path / "fourth"), QUICK, count, progress=False)
    with pytest.raises(UnknownNameError, match="checkpoint 'nothing'"):
        fit(replace(begun, init="nothing", out=tmp_path / "fifth"), QUICK, count, progress=False)
