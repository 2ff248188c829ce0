from pathlib import Path

import pytest
import torch

from pwm_gym.dynamics import average, load_checkpoint, resolve, save_checkpoint
from pwm_gym.errors import CheckpointError
from pwm_gym_cli import main


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The shipped checkpoint of PickCube, and one of PickCube alone with all its weights larger by 1."""
    first = load_checkpoint(resolve("panda", "PickCube"))
    other = tmp_path_factory.mktemp("other")
    with torch.no_grad():
        for value in first.model.parameters():
            value.add_(1.0)
    training = {**first.description["training"], "seen_tasks": ["PickCube"], "seen_joints": ["free"]}
    save_checkpoint(other, first.model, first.kind, list(first.banks.values()), training, {})
    return resolve("panda", "PickCube"), other


@pytest.mark.parametrize(("shares", "part"), [(None, 0.5), ((2, 6), 0.75)])
def test_weights_are_the_mean(folders, tmp_path, shares, part):
    average(folders, tmp_path, shares)
    one, other, mean = (load_checkpoint(folder) for folder in (*folders, tmp_path))
    for name, value in mean.model.state_dict().items():
        first, second = (c.model.state_dict()[name] for c in (one, other))
        mixed = (1.0 - part) * first + part * second if value.is_floating_point() else second
        torch.testing.assert_close(value, mixed)
    assert mean.banks.keys() == other.banks.keys() and mean.tasks == other.tasks
    assert mean.description["training"]["averaged"] == {str(folders[0]): 1.0 - part, str(folders[1]): part}
    assert mean.seen_tasks == one.seen_tasks != other.seen_tasks and set(mean.seen_joints) >= {"free"}


def test_the_command_does_the_same(folders, tmp_path, capsys):
    average(folders, tmp_path / "called", (2, 6))
    main(["average", *map(str, folders), "--shares", "2", "6", "--out", str(tmp_path / "told")])
    assert capsys.readouterr().out == f"checkpoint: {tmp_path / 'told'}\n"
    files = [(tmp_path / name / "model.safetensors").read_bytes() for name in ("called", "told")]
    assert files[0] == files[1]


def test_one_alone_is_no_mean(folders, tmp_path):
    with pytest.raises(CheckpointError, match="1 checkpoints to average; expected two at least"):
        average(folders[:1], tmp_path)


@pytest.mark.parametrize("shares", [(1.0,), (1.0, 0.0), (1.0, float("nan")), (1.0, float("inf"))])
def test_shares_that_are_none_are_refused(folders, tmp_path, shares):
    with pytest.raises(CheckpointError, match="of 2 checkpoints; expected as many positive numbers"):
        average(folders, tmp_path, shares)


def test_no_checkpoint_is_overwritten_by_the_mean(folders):
    before = (folders[1] / "model.safetensors").read_bytes()
    with pytest.raises(CheckpointError, match="is one of the checkpoints to average; expected another folder"):
        average(folders, folders[1])
    assert (folders[1] / "model.safetensors").read_bytes() == before


def test_other_sizes_are_refused(folders, tmp_path):
    with pytest.raises(CheckpointError, match=f"two-hands is of another kind or size than {folders[0]}"):
        average([resolve("two-hands", "TwoArmBoxCleanup"), folders[0]], tmp_path)
    assert not [*Path(tmp_path).iterdir()]
