"""A trained network in a folder: safetensors weights beside a JSON description; no pickles."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from pwm_gym.errors import CheckpointError

__all__ = ["load_weights", "read_description", "save_weights"]

_WEIGHTS, _DESCRIPTION = "model.safetensors", "config.json"


def save_weights(folder: Path, model: nn.Module, description: Mapping[str, Any]) -> None:
    """Write a model's weights and its description to ``folder``; each file is replaced as a whole."""
    folder.mkdir(parents=True, exist_ok=True)
    weights = {k: v.detach().cpu().contiguous() for k, v in model.state_dict().items()}
    save_file(weights, folder / f".{_WEIGHTS}")
    (folder / f".{_DESCRIPTION}").write_text(json.dumps(description, indent=2))
    for name in (_WEIGHTS, _DESCRIPTION):
        (folder / f".{name}").replace(folder / name)


def read_description(folder: Path, form: str, schema: int, keys: Iterable[str]) -> dict[str, Any]:
    """What :func:`save_weights` was told of the model.

    Args:
        folder: of the checkpoint.
        form: its "format".
        schema: the newest that is understood.
        keys: what it must hold.

    Raises:
        CheckpointError: missing, truncated, foreign, incomplete, or of a newer schema.
    """
    path = folder / _DESCRIPTION
    if not path.exists():
        raise CheckpointError(f"{folder} is not a checkpoint: it has no {_DESCRIPTION}")
    try:
        description = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise CheckpointError(f"{path} is truncated or not JSON ({error})") from error
    found = description.get("format") if isinstance(description, dict) else type(description).__name__
    if found != form:
        raise CheckpointError(f"{path} has format {found!r}; expected {form!r}")
    if description.get("schema", 0) > schema:
        raise CheckpointError(f"{path} has schema {description['schema']}; this version reads up to {schema}")
    if missing := set(keys) - description.keys():
        raise CheckpointError(f"{path} lacks {', '.join(sorted(missing))}")
    return dict(description)


def load_weights(model: nn.Module, folder: Path) -> None:
    """Fill ``model`` with the folder's weights; it is in evaluation mode then, without gradients.

    Raises:
        CheckpointError: the file is truncated, foreign, or of another architecture.
    """
    path = folder / _WEIGHTS
    try:
        weights = load_file(path)
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path} is truncated or not safetensors ({error})") from error
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        raise CheckpointError(f"{path} does not fit its {_DESCRIPTION}: {error}") from error
    model.eval().requires_grad_(False)
