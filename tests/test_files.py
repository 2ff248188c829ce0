"""A disk that is full or a folder that may not be written to: one clear error, and nothing half-written."""

from __future__ import annotations

import copy
import errno
import json
import os
import resource
from contextlib import contextmanager
from multiprocessing import get_context

import numpy as np
import pytest
import torch

from pwm_gym.cli import main
from pwm_gym.data import load_split
from pwm_gym.errors import DatasetError, PwmGymError, WriteError, writing
from pwm_gym.files import load_arrays, new_folder, replacing, save_arrays, write_atomically
from pwm_gym.learning.weights import load_weights, save_weights

NOISE = {"noise": np.random.default_rng(0).uniform(size=10_000)}  # which does not get smaller


@contextmanager
def room_for(size: int):
    """No file of this process may become larger than ``size`` bytes, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_file_that_does_not_fit_is_left_as_it_was(tmp_path):
    path = tmp_path / "arrays.npz"
    save_arrays(path, {"few": np.ones(3)})
    with room_for(20_000), pytest.raises(WriteError) as error:
        save_arrays(path, NOISE)
    assert str(error.value) == f"{path} cannot be written ({os.strerror(errno.EFBIG)})"
    assert list(load_arrays(path, "is damaged", DatasetError)[0]) == ["few"]
    assert list(tmp_path.iterdir()) == [path]


def test_several_processes_may_write_one_file(tmp_path):
    path = tmp_path / "note"
    with replacing(path) as one:
        one.write_text("one")
        with replacing(path) as other:
            other.write_text("other")
        assert path.read_text() == "other" and one != other
    assert path.read_text() == "one" and list(tmp_path.iterdir()) == [path]


def test_what_a_killed_process_left_is_cleared_away_later(tmp_path):
    path, fresh, stale = (tmp_path / name for name in ("note", ".note.fresh", ".note.stale"))
    for left in (fresh, stale):
        left.write_text("half")
    os.utime(stale, (0, 0))
    write_atomically(path, b"all")
    assert {*tmp_path.iterdir()} == {path, fresh}


def test_two_processes_collect_and_train_in_one_folder(worlds, recorder, tmp_path):
    """Each writes what it would have written alone, and neither reads half of the other's."""
    start = get_context("fork").Barrier(2)

    def write(number):
        start.wait()
        for k in range(30):
            save_weights(tmp_path, torch.nn.Linear(50, 50), {"k": k, "number": number})
            write_atomically(tmp_path / "shard", bytes([k]) * 100_000)

    processes = [get_context("fork").Process(target=write, args=(number,)) for number in range(2)]
    for process in processes:
        process.start()
    seen = 0
    while any(process.is_alive() for process in processes):
        if (tmp_path / "shard").exists():
            content = (tmp_path / "shard").read_bytes()
            assert content == content[:1] * 100_000
        if (tmp_path / "config.json").exists():
            load_weights(torch.nn.Linear(50, 50), tmp_path)
            assert json.loads((tmp_path / "config.json").read_text())["number"] in (0, 1)
            seen += 1
    assert seen and not any(process.exitcode for process in processes)
    assert not list(tmp_path.glob(".*"))


def test_weights_that_do_not_fit_are_named(tmp_path):
    with room_for(20_000), pytest.raises(WriteError, match=f"{tmp_path / 'checkpoint' / 'model.safetensors'} cannot"):
        save_weights(tmp_path / "checkpoint", torch.nn.Linear(100, 100), {})


def test_a_folder_that_cannot_be_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    path = tmp_path / "file" / "below.npz"
    with pytest.raises(WriteError, match=f"{path} cannot be written"):
        write_atomically(path, b"")
    with pytest.raises(WriteError, match=f"{path} cannot be written"), new_folder(path, DatasetError):
        pass


def test_a_new_folder_is_there_as_a_whole_or_not_at_all(tmp_path):
    folder = tmp_path / "new"
    with pytest.raises(KeyError), new_folder(folder, DatasetError) as root:
        (root / "half").write_text("")
        raise KeyError
    with (
        room_for(100),
        pytest.raises(WriteError, match=f"{folder} cannot be written"),
        new_folder(folder, DatasetError) as root,
    ):
        (root / "large").write_text("x" * 1000)
    assert not list(tmp_path.iterdir())
    with new_folder(folder, DatasetError) as root:
        (root / "all").write_text("")
    assert [path.name for path in tmp_path.rglob("*")] == ["new", "all"]
    told = f"{folder} holds something already; expected a new folder"
    with pytest.raises(DatasetError, match=told), new_folder(folder, DatasetError):
        pass


def test_a_librarys_own_error_is_told_too(tmp_path):
    with (
        pytest.raises(WriteError, match="x cannot be written \\(stream failed\\)"),
        writing(tmp_path / "x", RuntimeError),
    ):
        raise RuntimeError("stream failed")
    with pytest.raises(RuntimeError, match="another"), writing(tmp_path / "x"):
        raise RuntimeError("another")


def test_the_error_is_one_of_ours_and_the_systems_and_comes_back_from_another_process():
    error = copy.copy(WriteError("x cannot be written"))  # by the protocol that processes send it by
    assert isinstance(error, PwmGymError) and isinstance(error, OSError)
    assert str(error) == "x cannot be written"


def test_a_command_ends_in_one_line(worlds, recorder, tmp_path, monkeypatch):
    folder = recorder.write(recorder.dataset(worlds["cube"], "PickCube"), tmp_path / "own")
    out = tmp_path / "own" / "dataset.json" / "below"  # a file is in the way
    with pytest.raises(SystemExit) as end:
        main(["data", "export", "--data", str(folder), "--to", "lerobot", "--out", str(out)])
    assert str(end.value) == f"pwm-gym: {out} cannot be written ({os.strerror(errno.ENOTDIR)})"
    assert load_split(folder, "train").episodes

    def full(self):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "picture.png")

    monkeypatch.setattr("pwm_gym.commands.envs.Envs.run", full)
    with pytest.raises(SystemExit) as end:
        main(["envs"])
    assert str(end.value) == "pwm-gym: picture.png cannot be written (No space left on device)"

    def forbidden(self):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "picture.png")

    monkeypatch.setattr("pwm_gym.commands.envs.Envs.run", forbidden)
    with pytest.raises(SystemExit) as end:
        main(["envs"])
    assert str(end.value) == "pwm-gym: picture.png cannot be read or written (Permission denied)"


@pytest.mark.parametrize(
    "args",
    [
        "collect --out {out}",
        "train --data {data} --out {out}",
        "train-agent --algo ppo --out {out}",
        "train-agent --data {data} --out {out}",
        "plan --episodes 1 --threads 1 --save {out}",
        "rank random expert:0 --scenes 1 --out {out}",
        "publish --checkpoint panda --out {out}",
    ],
)
def test_commands_say_at_once_that_their_folder_cannot_be_written(args, worlds, recorder, tmp_path):
    for split in ("train", "validation"):
        data = recorder.write(recorder.dataset(worlds["cube"], "PickCube"), tmp_path / "data", split)
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "below"
    with pytest.raises(SystemExit, match="^pwm-gym: .*file/below.* cannot be written \\(Not a directory\\)$"):
        main(args.format(out=out, data=data).split())
