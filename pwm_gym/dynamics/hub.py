"""Checkpoints in Hugging Face's layout: a folder with weights, a configuration and a model card, or a repository.

A folder needs no network and no further package; repositories need the extra ``hub``.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pwm_gym.dynamics.checkpoint import Checkpoint, load_checkpoint, resolve
from pwm_gym.errors import CheckpointError, writing

__all__ = ["HUB", "download", "from_pretrained", "model_card", "push_to_hub", "save_pretrained"]

HUB = "hf://"
"""What the name of a repository begins with, ``hf://owner/name`` or ``hf://owner/name@revision``."""
_FILES = ("config.json", "model.safetensors", "scenes-*.npz")
_CARD = "README.md"


def save_pretrained(checkpoint: Checkpoint | str | Path, folder: str | Path) -> Path:
    """Write a checkpoint's files and its model card to a folder; files of another checkpoint there are replaced.

    Args:
        checkpoint: one that was loaded, its folder, or the name of a shipped one.
        folder: where to write.

    Raises:
        CheckpointError: the checkpoint is damaged, or the folder is its own.
    """
    found = checkpoint if isinstance(checkpoint, Checkpoint) else load_checkpoint(resolve(checkpoint, ""))
    folder = Path(folder)
    if folder.resolve() == found.folder.resolve():
        raise CheckpointError(f"{folder} is the checkpoint's own folder; expected another one")
    card = model_card(found)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for path in _of_checkpoint(folder):
            path.unlink()
        for path in _of_checkpoint(found.folder):
            shutil.copyfile(path, folder / path.name)
        (folder / _CARD).write_text(card)
    return folder


def from_pretrained(name: str | Path, device: str = "cpu") -> Checkpoint:
    """Read a checkpoint from a folder, from a repository ``hf://owner/name``, or a shipped one by its name.

    Raises:
        UnknownNameError: neither a folder nor a shipped name.
        CheckpointError: no such repository, no network, or a damaged checkpoint.
    """
    return load_checkpoint(resolve(name, ""), device)


def push_to_hub(
    checkpoint: Checkpoint | str | Path, repository: str, private: bool = False, message: str = "Checkpoint of pwm_gym"
) -> str:
    """Upload a checkpoint with its model card to a repository, which is made if there is none.

    Args:
        checkpoint: one that was loaded, its folder, or the name of a shipped one.
        repository: ``owner/name``; who is logged in by ``hf auth login`` must be allowed to write there.
        private: whether a new repository is private.
        message: of the commit.

    Returns:
        The commit's address.

    Raises:
        CheckpointError: no repository's name, or one that cannot be written.
        ImportError: the extra ``hub`` is missing.
    """
    import tempfile

    if not _names_repository(repository):
        raise CheckpointError(f"repository={repository!r}; expected owner/name")
    hub = _library()
    api = hub.HfApi()
    with tempfile.TemporaryDirectory() as folder:
        save_pretrained(checkpoint, folder)
        _told(repository, lambda: api.create_repo(repository, private=private, exist_ok=True))
        done = _told(
            repository, lambda: api.upload_folder(repo_id=repository, folder_path=folder, commit_message=message)
        )
    return str(done.commit_url)


def download(name: str) -> Path:
    """Folder in the local cache of a repository ``hf://owner/name[@revision]``, downloaded if it is not there.

    Raises:
        CheckpointError: no repository's name, no such repository, or neither network nor cache.
        ImportError: the extra ``hub`` is missing.
    """
    repository, _, revision = name.removeprefix(HUB).partition("@")
    if not _names_repository(repository):
        raise CheckpointError(f"checkpoint {name!r}; expected {HUB}owner/name or {HUB}owner/name@revision")
    hub = _library()
    path = _told(
        name, lambda: hub.snapshot_download(repository, revision=revision or None, allow_patterns=[*_FILES, _CARD])
    )
    return Path(path)


def _names_repository(name: str) -> bool:
    """Whether it is ``owner/name``."""
    return name.count("/") == 1 and all(name.split("/"))


def model_card(checkpoint: Checkpoint) -> str:
    """What a repository shows of a checkpoint, made from its description: Markdown with Hugging Face's front matter."""
    tasks = ", ".join(checkpoint.tasks)
    front = ["library_name: pwm_gym", "license: apache-2.0", "pipeline_tag: robotics"]
    front += ["tags:", *(f"- {tag}" for tag in ("world-model", "point-cloud", "gymnasium", "planning"))]
    rows = "\n".join(f"| {name} | {value} |" for name, value in _facts(checkpoint).items())
    first = checkpoint.tasks[0] if checkpoint.tasks else "PickCube"
    return f"""---
{chr(10).join(front)}
---

# A 3D point world model of {tasks}

A learned dynamics of completed point clouds for [pwm_gym](https://pypi.org/project/pwm-gym/): a Gymnasium environment
whose `step` is the model, with a simulator-backed twin.

```python
import gymnasium as gym

import pwm_gym

env = gym.make("pwm/{first}-v0", checkpoint="FOLDER OR hf://owner/name")
observation, info = env.reset(seed=0)
```

| | |
|---|---|
{rows}

Training settings and validation errors, as in `config.json`:

```json
{json.dumps(_details(checkpoint), indent=2)}
```
"""


def _facts(checkpoint: Checkpoint) -> dict[str, str]:
    description = checkpoint.description
    weights: Any = checkpoint.model
    count = sum(p.numel() for p in weights.parameters())
    return {
        "model": f"`{checkpoint.kind}`, {count / 1e6:.2f} M parameters",
        "robot's links": ", ".join(checkpoint.model.links.names),
        "action": f"{checkpoint.model.action_size} components",
        "scenes to start from": ", ".join(f"{name} ({len(bank)})" for name, bank in checkpoint.banks.items()),
        "tasks in training, earlier ones included": ", ".join(checkpoint.seen_tasks),
        "schema": str(description["schema"]),
    }


def _details(checkpoint: Checkpoint) -> dict[str, Any]:
    training = checkpoint.description["training"]
    return {"training": training.get("config", {}), "validation": checkpoint.description["metrics"]}


def _of_checkpoint(folder: Path) -> list[Path]:
    return [path for pattern in _FILES for path in sorted(folder.glob(pattern))]


def _library() -> Any:
    try:
        import huggingface_hub
    except ImportError as error:
        raise ImportError("repositories of checkpoints need huggingface_hub: pip install 'pwm-gym[hub]'") from error
    return huggingface_hub


def _told(name: str, action: Callable[[], Any]) -> Any:
    """The result of something asked of the hub, whose many errors become one."""
    from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]  # of its HTTP library

    try:
        return action()
    except (OSError, ValueError, HTTPError) as error:  # the library's own errors are of these
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise CheckpointError(f"cannot reach {name!r} on the Hugging Face hub: {reason}") from error
