import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.dynamics import (
    MODELS,
    CompactConfig,
    SceneBank,
    build_model,
    load_checkpoint,
    resolve,
    save_checkpoint,
)
from pwm_gym.dynamics.checkpoint import SCHEMA, SHIPPED, default_checkpoints, use_device
from pwm_gym.errors import CheckpointError, UnknownNameError
from pwm_gym.scene import batch_state
from pwm_gym.scene.se3 import pose7_from_matrix

SMALL = {"points": 8, "point_width": 8, "width": 16, "blocks": 1, "heads": 2, "arm_width": 8}


def bank_of(world, task, count=5, goal=3, assets=()):
    """Scenes at rest, with a cloud for each combination of assets."""
    state = world.state(count, moving=False)
    rng = np.random.default_rng(0)
    kinds = max(1, len(assets))
    return SceneBank(
        task,
        state.layout,
        np.stack([world.clouds(seed=k)[0].numpy() for k in range(kinds)]),
        pose7_from_matrix(state.poses()).numpy(),
        rng.normal(size=(count, goal)).astype(np.float32),
        np.arange(count) % kinds,
        assets,
        rng.normal(size=(count, 9)).astype(np.float32),
    )


@pytest.fixture
def world(worlds):
    return worlds["cube"]


@pytest.fixture
def bank(world):
    return bank_of(world, "PickCube")


@pytest.fixture
def banks(worlds, bank):
    """Of three tasks of one robot: one with other assets in each scene, one without a goal."""
    layout = worlds["drawer"].layout
    assets = tuple(tuple(f"{name} {k}" for name in layout.names) for k in range(3))
    return [bank, bank_of(worlds["drawer"], "OpenDrawer", 7, 1, assets), bank_of(worlds["lid"], "OpenLid", 2, 0)]


def make(world, kind="compact", **settings):
    torch.manual_seed(0)
    model = build_model(kind, world.layout, world.control, {**SMALL, **settings} if kind == "compact" else settings)
    with torch.no_grad():
        for value in model.state_dict().values():
            if value.is_floating_point():
                value.uniform_(-0.1, 0.1)
    return model.eval()


@pytest.fixture
def folder(world, banks, tmp_path):
    save_checkpoint(tmp_path / "mine", make(world), "compact", banks, {"steps": 3}, {"error": 0.5})
    return tmp_path / "mine"


def edit(folder, **changes):
    path = folder / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_weights_and_description_survive(folder, world):
    loaded = load_checkpoint(folder)
    expected, found = make(world).state_dict(), loaded.model.state_dict()
    assert found.keys() == expected.keys()
    assert all(torch.equal(found[k], expected[k]) for k in expected)
    assert loaded.model.links == world.layout.robot()
    assert (loaded.kind, loaded.model.control) == ("compact", world.control)
    assert loaded.description["training"] == {"steps": 3} and loaded.description["metrics"] == {"error": 0.5}
    assert not loaded.model.training and not any(p.requires_grad for p in loaded.model.parameters())


def test_every_tasks_bank_survives(folder, banks):
    loaded = load_checkpoint(folder)
    assert loaded.tasks == ("PickCube", "OpenDrawer", "OpenLid") and loaded.banks.keys() == {*loaded.tasks}
    for bank in banks:
        found = loaded.bank(bank.task)
        assert (found.task, found.layout, found.assets, len(found)) == (bank.task, bank.layout, bank.assets, len(bank))
        for name in ("clouds", "poses", "goals", "combination", "joints"):
            np.testing.assert_array_equal(getattr(found, name), getattr(bank, name))
    with pytest.raises(CheckpointError, match=r"has scenes of OpenDrawer, OpenLid, PickCube; expected 'StackCube'"):
        loaded.bank("StackCube")


def test_a_scene_has_the_clouds_and_names_of_its_assets(folder, banks):
    bank = load_checkpoint(folder).bank("OpenDrawer")
    for index in (0, 4, 5):
        scene = bank.scene(index).validate("OpenDrawer", bank.layout, 1)
        np.testing.assert_array_equal(scene.clouds, banks[1].clouds[index % 3])
        assert scene.assets == banks[1].assets[index % 3]
        np.testing.assert_array_equal(scene.joints, [banks[1].joints[index], np.zeros(9)])
    assert load_checkpoint(folder).bank("OpenLid").scene(1).goal.shape == (0,)


def test_one_model_moves_the_scenes_of_every_bank(folder, world, banks):
    loaded = load_checkpoint(folder)
    for bank in banks:
        state, action = batch_state([bank.scene(0), bank.scene(1)]), torch.full((2, 7), 0.3)
        expected = make(world)
        with torch.no_grad():
            expected = expected.step(expected.prepare(state), action).frames
        assert torch.equal(loaded.model.step(loaded.model.prepare(state), action).frames, expected)


@pytest.mark.parametrize("kind", sorted({*MODELS} - {"paper"}))
def test_every_kind_of_model_survives(world, bank, tmp_path, kind):
    settings = {"width": 32} if kind == "compact" else {}
    save_checkpoint(tmp_path, make(world, kind, **settings), kind, [bank], {}, {})
    loaded = load_checkpoint(tmp_path)
    assert loaded.kind == kind
    if kind == "compact":
        assert loaded.model.config == CompactConfig(**{**SMALL, "width": 32})


def test_a_robot_of_two_arms_survives(worlds, tmp_path):
    world = worlds["two arms"]
    save_checkpoint(tmp_path, make(world), "compact", [bank_of(world, "Hand over")], {}, {})
    loaded = load_checkpoint(tmp_path)
    assert loaded.model.links == world.layout.robot() and loaded.model.control == world.control
    assert loaded.bank("Hand over").task == "Hand over"


def test_saving_again_replaces(folder, world, bank):
    save_checkpoint(folder, make(world, width=32), "compact", [bank], {}, {})
    loaded = load_checkpoint(folder)
    assert loaded.model.config.width == 32
    assert loaded.banks.keys() == {*loaded.tasks} == {"PickCube"}  # scenes of tasks of before are gone


def test_the_default_model_with_its_bank_is_under_8_mb(world, tmp_path):
    rng = np.random.default_rng(0)
    whole = replace(world, points=300)
    bank = replace(
        bank_of(whole, "PickCube", 256),
        clouds=rng.normal(size=(1, 1200, 3)).astype(np.float32),
        poses=rng.normal(size=(256, 4, 7)).astype(np.float32),
    )
    save_checkpoint(tmp_path, build_model("compact", whole.layout, whole.control), "compact", [bank], {}, {})
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) < 8e6


@pytest.mark.parametrize("name", ["model.safetensors", "config.json", "scenes-OpenDrawer.npz"])
@pytest.mark.parametrize("kept", [0.0, 0.4, 0.99])
def test_a_truncated_file_is_named(folder, name, kept):
    path = folder / name
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(CheckpointError, match=rf"{name} is truncated or not"):
        load_checkpoint(folder)


@pytest.mark.parametrize("name", ["model.safetensors", "config.json"])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(CheckpointError, match=name):
        load_checkpoint(folder)


def test_a_model_without_scenes_loads(folder):
    for path in folder.glob("scenes-*.npz"):
        path.unlink()
    loaded = load_checkpoint(folder)
    assert loaded.banks == {}
    with pytest.raises(CheckpointError, match=r"has scenes of no task; expected 'PickCube'"):
        loaded.bank("PickCube")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "has format 'other'; expected 'pwm_gym.checkpoint'"),
        ({"schema": SCHEMA + 1}, f"has schema {SCHEMA + 1}; this version reads up to {SCHEMA}"),
        ({"schema": "new"}, r"Expected `int`, got `str` - at `\$\.schema`"),
        ({"tasks": "PickCube"}, r"Expected `array`, got `str` - at `\$\.tasks`"),
        ({"config": {"width": 64}}, r"model\.safetensors does not fit its config\.json"),
        ({"config": {"depth": 64}}, "describes no model .*unknown compact setting 'depth'"),
        ({"config": {"blocks": 0}}, "describes no model .*blocks=0; expected at least 1"),
        ({"config": 3}, r"Expected `object`, got `int` - at `\$\.config`"),
        ({"model": "compct"}, "describes no model .*Did you mean 'compact'"),
        ({"links": {"entities": [{"name": 3}]}}, r"layout: Expected `str`, got `int`"),
        ({"links": None}, "layout: Expected `object`"),
        ({"control": {"channels": [{"kind": "finger", "start": 2, "stop": 3}]}}, "expected them to begin at 0"),
        ({"control": {"channels": 3}}, r"control: Expected `array`, got `int`"),
    ],
)
def test_what_does_not_fit_is_explained(folder, changes, message):
    edit(folder, **changes)
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(folder)


def test_a_checkpoint_of_version_0_1_is_refused_with_advice(folder):
    old = {"format": "pwm_gym.checkpoint", "schema": 1, "task": "PickCube", "model": "compact", "action_size": 7}
    (folder / "config.json").write_text(json.dumps(old))
    with pytest.raises(
        CheckpointError, match=r"mine is of version 0\.1, whose weights do not fit; train it again"
    ) as e:
        load_checkpoint(folder)
    assert "pwm-gym train --data DATA" in str(e.value) and "\n" not in str(e.value)


# Banks


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"clouds": np.zeros((3, 5, 3), np.float32)}, r"clouds has shape \(3, 5, 3\); expected \(3, 112, 3\)"),
        ({"clouds": np.float32(0.0)}, r"clouds has shape \(\)"),
        ({"poses": np.float32(0.0)}, r"poses has shape \(\)"),
        ({"poses": np.zeros((7, 2, 7), np.float32)}, r"poses has shape \(7, 2, 7\); expected \(7, 7, 7\)"),
        ({"goals": np.zeros((6, 1), np.float32)}, r"goals has shape \(6, 1\); expected \(7, 1\)"),
        ({"goals": np.zeros((7,), np.float32)}, r"goals has shape \(7,\)"),
        ({"joints": np.zeros((7, 9, 2), np.float32)}, r"joints has shape \(7, 9, 2\); expected \(7, 9\)"),
        ({"combination": np.full(7, 3)}, "combination holds no places among 3 combinations of assets"),
        ({"combination": np.full(7, -1)}, "combination holds no places"),
        ({"combination": np.zeros(7)}, "combination holds no places"),
        ({"combination": np.zeros(5, int)}, r"combination has shape \(5,\); expected \(7,\)"),
        ({"assets": (("a",) * 7,)}, r"assets of 1 combinations; expected 3"),
        ({"assets": (("a",) * 6,) * 3}, r"names 6 assets in a combination; expected 7"),
        ({"poses": np.full((7, 7, 7), np.nan, np.float32)}, "poses holds 343 values that are not finite"),
    ],
)
def test_arrays_of_a_bank_that_do_not_fit_each_other_are_refused(banks, tmp_path, changes, message):
    path = tmp_path / "scenes-OpenDrawer.npz"
    replace(banks[1], **changes).save(path)
    with pytest.raises(CheckpointError, match=message):
        SceneBank.load(path)


# Names


@pytest.fixture
def ships(monkeypatch, tmp_path, world, banks):
    """A package with two checkpoints: one of all three tasks, and one of a task of its own."""
    module = sys.modules[resolve.__module__]
    monkeypatch.setattr(module, "SHIPPED", tmp_path / "ships")
    save_checkpoint(tmp_path / "ships" / "Panda", make(world), "compact", banks, {}, {})
    save_checkpoint(tmp_path / "ships" / "OpenLid", make(world), "compact", banks[2:], {}, {})
    return tmp_path / "ships"


def test_resolve_takes_folders_shipped_names_and_the_default(ships, folder):
    assert resolve(folder, "PickCube") == folder
    assert resolve("Panda", "OpenLid") == ships / "Panda"
    assert resolve("default", "PickCube") == resolve("default", "OpenDrawer") == ships / "Panda"
    assert resolve("default", "OpenLid") == ships / "OpenLid"  # its own comes before a shared one
    with pytest.raises(UnknownNameError, match=r"unknown checkpoint 'Panada'; known: .*Did you mean 'Panda'"):
        resolve("Panada", "PickCube")
    with pytest.raises(UnknownNameError, match=r"no checkpoint of task 'StackCube' is shipped \(shipped: OpenDrawer"):
        resolve("default", "StackCube")


def test_the_shipped_checkpoints_load_and_are_under_8_mb():
    for folder in {*default_checkpoints().values()}:
        assert folder.parent == SHIPPED
        loaded = load_checkpoint(folder)
        assert {*loaded.banks} >= {*loaded.tasks}
        assert sum(p.stat().st_size for p in folder.iterdir()) < 8e6


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_said_so():
    assert use_device("cpu") == torch.device("cpu")
    with pytest.raises(CheckpointError, match="device='cuda', but PyTorch .* sees no CUDA device; use 'cpu'"):
        use_device("cuda")


def test_coffee_preparation_has_a_model_that_never_saw_it():
    checkpoint = load_checkpoint(resolve("default", "CoffeePreparation"))
    assert checkpoint.folder.name == "kitchen" and len(checkpoint.bank("CoffeePreparation")) == 64
    assert checkpoint.tasks == ("MugCleanup", "Coffee")
    assert checkpoint.seen_tasks == ("PickCube", "StackCube", "PickYCB", "MugCleanup", "Coffee")
    assert set(checkpoint.description["training"]["data"]["tasks"]) == {"MugCleanup", "Coffee", "PickYCB"}
    assert checkpoint.seen_joints == ("fixed", "free", "prismatic", "revolute")
