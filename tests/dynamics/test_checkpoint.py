import json

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
from pwm_gym.dynamics.checkpoint import SCHEMA, SHIPPED, use_device
from pwm_gym.errors import CheckpointError, UnknownNameError
from pwm_gym.robots import Control
from pwm_gym.scene import batch_state
from pwm_gym.scene.se3 import pose7_from_matrix

CONTROL = Control(vectors=((0, 3), (3, 6)))


@pytest.fixture
def bank(hand_scenes):
    state = hand_scenes(5, moving=False)
    poses = pose7_from_matrix(state.poses()).numpy()
    goals = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    return SceneBank("PickCube", state.layout, state.clouds[0].numpy(), poses, goals)


def make(bank, kind="compact", **settings):
    torch.manual_seed(0)
    model = build_model(kind, bank.layout, 7, CONTROL, settings)
    with torch.no_grad():
        for value in model.state_dict().values():
            if value.is_floating_point():
                value.uniform_(-0.1, 0.1)
    return model.eval()


@pytest.fixture
def folder(bank, tmp_path):
    save_checkpoint(tmp_path / "mine", make(bank), "compact", bank, {"steps": 3}, {"error": 0.5})
    return tmp_path / "mine"


def edit(folder, **changes):
    path = folder / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_weights_bank_and_description_survive(folder, bank):
    loaded = load_checkpoint(folder, "PickCube")
    expected = make(bank).state_dict()
    found = loaded.model.state_dict()
    assert found.keys() == expected.keys()
    assert all(torch.equal(found[k], expected[k]) for k in expected)
    for name in ("clouds", "poses", "goals"):
        np.testing.assert_array_equal(getattr(loaded.bank, name), getattr(bank, name))
    assert loaded.bank.layout == loaded.model.layout == bank.layout
    assert (loaded.task, loaded.kind, loaded.model.control) == ("PickCube", "compact", CONTROL)
    assert loaded.description["training"] == {"steps": 3} and loaded.description["metrics"] == {"error": 0.5}
    assert not loaded.model.training and not any(p.requires_grad for p in loaded.model.parameters())


def test_a_loaded_model_predicts_the_same(folder, bank):
    state, action = batch_state([bank.scene(1), bank.scene(4)]), torch.full((2, 7), 0.3)
    with torch.no_grad():
        expected = make(bank).step(state, action).frames
    assert torch.equal(load_checkpoint(folder).model.step(state, action).frames, expected)


@pytest.mark.parametrize("kind", sorted(set(MODELS) - {"paper"}))
def test_every_kind_of_model_survives(bank, tmp_path, kind):
    settings = {"width": 32, "blocks": 1} if kind == "compact" else {}
    save_checkpoint(tmp_path, make(bank, kind, **settings), kind, bank, {}, {})
    loaded = load_checkpoint(tmp_path)
    assert loaded.kind == kind
    if kind == "compact":
        assert loaded.model.config == CompactConfig(width=32, blocks=1)


def test_saving_again_replaces(folder, bank):
    other = make(bank, width=32)
    save_checkpoint(folder, other, "compact", bank, {}, {})
    assert load_checkpoint(folder).model.config.width == 32
    assert {p.name for p in folder.iterdir()} == {"model.safetensors", "config.json", "scenes.npz"}


def test_the_default_model_with_its_bank_is_under_8_mb(bank, tmp_path):
    poses, goals = np.random.default_rng(0).normal(size=(256, 4, 7)).astype(np.float32), np.zeros((256, 3))
    clouds = np.random.default_rng(1).normal(size=(1200, 3)).astype(np.float32)
    whole = SceneBank("PickCube", bank.layout, clouds, poses, goals)
    save_checkpoint(tmp_path, make(bank), "compact", whole, {}, {})
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) < 8e6


def test_the_shipped_checkpoints_load_and_are_under_8_mb():
    shipped = list(SHIPPED.glob("*/config.json"))
    assert shipped
    for path in shipped:
        load_checkpoint(path.parent, path.parent.name)
        assert sum(p.stat().st_size for p in path.parent.iterdir()) < 8e6


def test_a_banks_scenes_are_at_rest(bank):
    scene = bank.scene(2).validate("PickCube", bank.layout, 3)
    assert (scene.poses == scene.poses[0]).all()
    np.testing.assert_array_equal(scene.goal, bank.goals[2])


@pytest.mark.parametrize("name", ["model.safetensors", "config.json", "scenes.npz"])
@pytest.mark.parametrize("kept", [0.0, 0.4, 0.99])
def test_a_truncated_file_is_named(folder, name, kept):
    path = folder / name
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(CheckpointError, match=rf"{name} is truncated or not"):
        load_checkpoint(folder)


@pytest.mark.parametrize("name", ["model.safetensors", "config.json", "scenes.npz"])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(CheckpointError, match=name):
        load_checkpoint(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "has format 'other'; expected 'pwm_gym.checkpoint'"),
        ({"schema": SCHEMA + 1}, f"has schema {SCHEMA + 1}; this version reads up to {SCHEMA}"),
        ({"task": "StackCube"}, "is a checkpoint of task 'StackCube'; expected 'PickCube'"),
        ({"config": {"width": 64}}, r"model\.safetensors does not fit its config\.json"),
        ({"config": {"depth": 64}}, "unknown compact setting 'depth'"),
    ],
)
def test_what_does_not_fit_is_explained(folder, changes, message):
    edit(folder, **changes)
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(folder, "PickCube")


def test_resolve_takes_folders_and_shipped_names(folder):
    assert resolve(folder, "PickCube") == folder
    assert resolve("default", "PickCube") == resolve("PickCube", "PickCube") == SHIPPED / "PickCube"
    with pytest.raises(UnknownNameError, match=r"unknown checkpoint 'PickCub'; known: .*Did you mean 'PickCube'"):
        resolve("PickCub", "PickCube")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_said_so():
    assert use_device("cpu") == torch.device("cpu")
    with pytest.raises(CheckpointError, match="device='cuda', but PyTorch .* sees no CUDA device; use 'cpu'"):
        use_device("cuda")
