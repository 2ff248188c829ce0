import json
from dataclasses import dataclass

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from pwm_gym.errors import CheckpointError
from pwm_gym.learning import load_weights, read_description, save_weights

FORM, SCHEMA = "test.form", 2


@dataclass(frozen=True)
class Fields:
    config: dict[str, int]


@pytest.fixture
def model():
    torch.manual_seed(0)
    return nn.Linear(3, 2)


@pytest.fixture
def folder(model, tmp_path):
    description = {"format": FORM, "schema": SCHEMA, "config": {"width": 3}, "metrics": {"error": float("nan")}}
    save_weights(tmp_path / "net", model, description)
    return tmp_path / "net"


def read(folder):
    return read_description(folder, FORM, SCHEMA, Fields)


def test_weights_and_description_survive(folder, model):
    other = nn.Linear(3, 2)
    load_weights(other, folder)
    assert torch.equal(other.weight, model.weight) and not other.weight.requires_grad and not other.training
    assert read(folder) == {"format": FORM, "schema": 2, "config": {"width": 3}, "metrics": {"error": None}}
    assert {p.name for p in folder.iterdir()} == {"config.json", "model.safetensors"}


def test_weights_may_be_read_by_whoever_may_read_their_description(folder):
    modes = {(folder / name).stat().st_mode for name in ("model.safetensors", "config.json")}
    assert len(modes) == 1


def test_weights_that_are_not_finite_are_not_saved(folder, model):
    before = (folder / "model.safetensors").read_bytes()
    with torch.no_grad():
        model.bias[1] = float("nan")
    with pytest.raises(CheckpointError, match="'bias' holds 1 values that are not finite"):
        save_weights(folder, model, {"format": FORM, "schema": 1})
    assert (folder / "model.safetensors").read_bytes() == before


def test_weights_that_are_not_finite_are_not_loaded(folder, model):
    save_file(
        {"weight": model.weight.detach() * float("inf"), "bias": model.bias.detach()}, folder / "model.safetensors"
    )
    with pytest.raises(CheckpointError, match=r"model\.safetensors: 'weight' holds 6 values"):
        load_weights(nn.Linear(3, 2), folder)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is truncated or not valid"),
        (b"\xff\xfe{}", "is truncated or not valid"),
        (b'{"format": "\xff"}', "is truncated or not valid"),
        (b"[" * 100_000, "is truncated or not valid"),
        (b'{"a":' * 50_000, "is truncated or not valid"),
        (b"[1, 2]", "Expected `object`"),
        (b'{"format": 3}', "has format 3; expected 'test.form'"),
        (json.dumps({"format": FORM, "schema": "2"}).encode(), "Expected `int`, got `str`"),
        (json.dumps({"format": FORM, "schema": 10**30}).encode(), "schema"),
        (json.dumps({"format": FORM, "schema": 3}).encode(), "has schema 3; this version reads up to 2"),
        (json.dumps({"format": FORM, "schema": 2}).encode(), "missing required field `config`"),
        (json.dumps({"format": FORM, "schema": 2, "config": {"width": "a"}}).encode(), "Expected `int`, got `str`"),
    ],
)
def test_a_damaged_description_is_a_clear_error(folder, content, message):
    (folder / "config.json").write_bytes(content)
    with pytest.raises(CheckpointError, match=message):
        read(folder)


@pytest.mark.parametrize("name", ["config.json", "model.safetensors"])
def test_a_folder_in_a_files_place_is_a_clear_error(folder, name):
    (folder / name).unlink()
    (folder / name).mkdir()
    with pytest.raises(CheckpointError, match=name):
        read(folder)
        load_weights(nn.Linear(3, 2), folder)
