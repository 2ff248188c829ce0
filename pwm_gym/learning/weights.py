"""A trained network in a folder: safetensors weights beside a JSON description; no pickles."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from pwm_gym.errors import CheckpointError, writing
from pwm_gym.files import replacing
from pwm_gym.schema import convert, read_json

__all__ = ["digest", "load_weights", "read_description", "rebuild", "save_weights"]

_WEIGHTS, _DESCRIPTION = "model.safetensors", "config.json"
_DAMAGE = (SafetensorError, OSError, ValueError, TypeError, LookupError, RuntimeError, MemoryError, OverflowError)
"""What safetensors and PyTorch raise on damaged files."""
_NO_MODEL = (RuntimeError, ValueError, TypeError, ArithmeticError, LookupError, MemoryError, AttributeError)
_LARGEST = 4096
"""Layers, or channels of one: a larger number is damage, and would take the machine's memory."""

_Model = TypeVar("_Model")


@dataclass(frozen=True)
class _Head:
    """What every description begins with."""

    format: str
    schema: int


def save_weights(folder: Path, model: nn.Module, description: Mapping[str, Any]) -> None:
    """Write a model's weights and its description to ``folder``; each file is replaced as a whole.

    Raises:
        CheckpointError: a weight is not finite; what the folder held stays.
        WriteError: the disk is full, or the folder may not be written to.
    """
    weights = {k: v.detach().cpu().contiguous() for k, v in model.state_dict().items()}
    _check_finite(weights, model, f"the weights for {folder}")
    text = json.dumps(_without_nan(description), indent=2, allow_nan=False)
    with (
        writing(folder),
        replacing(folder / _DESCRIPTION) as description_file,
        replacing(folder / _WEIGHTS) as weights_file,
    ):
        weights_file.write_bytes(save(weights))  # its own save_file() makes files that others may not read
        description_file.write_text(text)


def read_description(folder: Path, form: str, schema: int, fields: type, old: str = "") -> dict[str, Any]:
    """What :func:`save_weights` was told of the model.

    Args:
        folder: of the checkpoint.
        form: its "format".
        schema: the newest that is understood.
        fields: dataclass of what it must hold besides; it may hold more.
        old: what is said of one of an older schema; empty where those are read, too.

    Raises:
        CheckpointError: missing, damaged, foreign, incomplete, of wrong types, or of a newer schema.
    """
    path = folder / _DESCRIPTION
    if not path.exists():
        raise CheckpointError(f"{folder} is not a checkpoint: it has no {_DESCRIPTION}")
    description = read_json(path, dict[str, Any], CheckpointError)
    found = description.get("format")
    if found != form:
        raise CheckpointError(f"{path} has format {found!r}; expected {form!r}")
    head = convert(description, _Head, CheckpointError, str(path))
    if head.schema > schema:
        raise CheckpointError(f"{path} has schema {head.schema}; this version reads up to {schema}")
    if old and head.schema < schema:
        raise CheckpointError(f"{folder} {old}")
    convert(description, fields, CheckpointError, str(path))
    return description


def rebuild(folder: Path, config: Mapping[str, Any], build: Callable[[], _Model]) -> _Model:
    """The network that a description tells of, with weights that are there to be replaced.

    Args:
        folder: of the checkpoint.
        config: the network's sizes.
        build: builds it.

    Raises:
        CheckpointError: they describe no network, or one that is too large.
    """
    for name, value in config.items():
        for size in value if isinstance(value, list | tuple) else (value,):
            if isinstance(size, int) and size > _LARGEST:
                raise CheckpointError(f"{folder}: its {_DESCRIPTION} has {name}={value}; expected at most {_LARGEST}")
    with torch.random.fork_rng(devices=[]):
        try:
            return build()
        except _NO_MODEL as error:
            raise CheckpointError(f"{folder}: its {_DESCRIPTION} describes no model ({error})") from error


def load_weights(model: nn.Module, folder: Path) -> None:
    """Fill ``model`` with the folder's weights; it is in evaluation mode then, without gradients.

    Raises:
        CheckpointError: the file is missing, truncated, foreign, of another architecture, or a weight is not finite.
    """
    path = folder / _WEIGHTS
    if not path.exists():
        raise CheckpointError(f"{folder} is not a checkpoint: it has no {_WEIGHTS}")
    try:
        weights = load_file(path)
    except _DAMAGE as error:
        raise CheckpointError(f"{path} is truncated or not safetensors ({error})") from error
    _check_finite(weights, model, str(path))
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        raise CheckpointError(f"{path} does not fit its {_DESCRIPTION}: {error}") from error
    model.eval().requires_grad_(False)


def digest(folder: Path) -> str:
    """Hash of a checkpoint's weights and description."""
    return hashlib.sha256(b"".join((folder / name).read_bytes() for name in (_WEIGHTS, _DESCRIPTION))).hexdigest()


def _check_finite(weights: Mapping[str, Tensor], model: nn.Module, what: str) -> None:
    """Raise :class:`CheckpointError` where a tensor holds a NaN, or a parameter an infinity (a limit may be one)."""
    parameters = {name for name, _ in model.named_parameters()}
    for name, value in weights.items():
        if not value.is_floating_point():
            continue
        wrong = ~torch.isfinite(value) if name in parameters else torch.isnan(value)
        if bool(wrong.any()):
            raise CheckpointError(f"{what}: {name!r} holds {int(wrong.sum())} values that are not finite")


def _without_nan(value: Any) -> Any:
    """The same JSON values with null for numbers that JSON has no word for."""
    if isinstance(value, Mapping):
        return {k: _without_nan(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
