"""Checkpoints as folders with a model card, and in repositories."""

import re
from types import SimpleNamespace

import gymnasium as gym
import huggingface_hub
import numpy as np
import pytest

from pwm_gym.cli import main
from pwm_gym.dynamics import from_pretrained, load_checkpoint, push_to_hub, resolve, save_pretrained
from pwm_gym.errors import CheckpointError, UnknownNameError


@pytest.fixture
def folder(tmp_path):
    return save_pretrained("panda", tmp_path / "published")


def test_a_folder_holds_the_checkpoint_and_its_card_and_makes_the_same_environment(folder):
    own = resolve("panda", "PickCube")
    assert {path.name for path in folder.iterdir()} == {path.name for path in own.iterdir()} | {"README.md"}
    assert from_pretrained(folder).tasks == load_checkpoint(own).tasks
    ends = []
    for checkpoint in ("panda", str(folder)):
        env = gym.make("pwm/PickCube-v0", checkpoint=checkpoint)
        env.reset(seed=3)
        ends.append(env.step(np.full(7, 0.5, np.float32))[0]["points"])
    np.testing.assert_array_equal(*ends)


def test_the_card_tells_what_the_checkpoint_is(folder):
    card, found = (folder / "README.md").read_text(), load_checkpoint(folder)
    assert card.startswith("---\nlibrary_name: pwm_gym\nlicense: apache-2.0\npipeline_tag: robotics\n")
    count = sum(p.numel() for p in found.model.parameters())
    assert f"{count / 1e6:.2f} M parameters" in card
    for task, bank in found.banks.items():
        assert f"{task} ({len(bank)})" in card
    code = re.search(r"```python\n(.*?)```", card, re.S)[1].replace("FOLDER OR hf://owner/name", str(folder))
    names: dict = {}
    exec(compile(code, "card", "exec"), names)
    assert names["observation"]["points"].shape == (1200, 3)


def test_what_another_checkpoint_left_in_a_folder_goes(folder):
    (folder / "scenes-Old.npz").write_bytes(b"old")
    (folder / "notes.txt").write_text("mine")
    save_pretrained(load_checkpoint(resolve("kitchen", "Coffee")), folder)
    assert from_pretrained(folder).tasks == ("MugCleanup", "Coffee")
    assert not (folder / "scenes-Old.npz").exists() and (folder / "notes.txt").read_text() == "mine"
    with pytest.raises(CheckpointError, match="is the checkpoint's own folder"):
        save_pretrained(folder, folder)


def test_a_repository_is_downloaded_at_its_revision(folder, monkeypatch):
    asked = []

    def snapshot(repository, revision, allow_patterns):
        asked.append((repository, revision, allow_patterns))
        return str(folder)

    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot)
    assert from_pretrained("hf://someone/panda@v2").folder == folder
    env = gym.make("pwm/PickCube-v0", checkpoint="hf://someone/panda")
    assert env.unwrapped.vector.checkpoint.folder == folder
    assert [one[:2] for one in asked] == [("someone/panda", "v2"), ("someone/panda", None)]
    assert "model.safetensors" in asked[0][2] and not any("pickle" in pattern for pattern in asked[0][2])


def test_a_repository_without_network_is_told_in_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(
        CheckpointError, match=r"cannot reach 'hf://someone/not-there' on the Hugging Face hub: \w"
    ) as told:
        from_pretrained("hf://someone/not-there")
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("name", ["hf://", "hf://panda", "hf://a/b/c", "hf:///b"])
def test_names_that_are_no_repositories(name):
    with pytest.raises(CheckpointError, match="expected hf://owner/name"):
        from_pretrained(name)


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(UnknownNameError, match="Did you mean 'panda'"):
        from_pretrained("pandas")


def test_an_upload_sends_the_files_and_returns_the_commit(monkeypatch):
    calls = []

    class Api:
        def create_repo(self, repository, private, exist_ok):
            calls.append(("create", repository, private, exist_ok))

        def upload_folder(self, repo_id, folder_path, commit_message):
            from pathlib import Path

            calls.append(("upload", repo_id, {p.name for p in Path(folder_path).iterdir()}))
            return SimpleNamespace(commit_url="https://huggingface.co/someone/panda/commit/1")

    monkeypatch.setattr(huggingface_hub, "HfApi", Api)
    assert push_to_hub("panda", "someone/panda", private=True).endswith("/commit/1")
    assert calls[0] == ("create", "someone/panda", True, True)
    assert {"README.md", "config.json", "model.safetensors", "scenes-PickCube.npz"} <= calls[1][2]


@pytest.mark.parametrize("name", ["none", "a/b/c", "/panda", "someone/"])
def test_a_repository_has_an_owner_and_a_name(name):
    with pytest.raises(CheckpointError, match=f"repository='{name}'; expected owner/name"):
        push_to_hub("panda", name)


def test_the_command_writes_a_folder_or_uploads(tmp_path, capsys):
    main(["publish", "--checkpoint", "kitchen", "--out", str(tmp_path / "out")])
    assert str(tmp_path / "out") in capsys.readouterr().out
    assert from_pretrained(tmp_path / "out").kind == "compact"
    with pytest.raises(SystemExit, match="expected either --out FOLDER or --repository owner/name"):
        main(["publish", "--checkpoint", "kitchen"])
