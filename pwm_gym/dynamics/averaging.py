"""One checkpoint out of several that a training went through."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from pwm_gym.errors import CheckpointError

__all__ = ["average"]


def average(folders: Sequence[str | Path], out: str | Path, shares: Sequence[float] | None = None) -> None:
    """Write a checkpoint whose weights are the mean of several, each trained on from another of them.

    What one training forgets of another's data, the mean often knows (Wortsman et al., "Model soups", 2022). Scenes,
    description and what is not a floating-point number are those of the last; tasks and kinds of joints that any of
    them has seen, the mean has seen.

    Args:
        folders: of the checkpoints.
        out: folder of the new one.
        shares: of each in the mean; None gives all the same. Only their ratios count.

    Raises:
        CheckpointError: fewer than two, one that cannot be read, one of another kind or size than the last, shares of
            another number, or that are not positive, or one of their folders for the mean.

    Example:
        >>> average(["runs/one/checkpoint", "runs/two/checkpoint"], "runs/mean")  # doctest: +SKIP
    """
    if len(folders) < 2:
        raise CheckpointError(f"{len(folders)} checkpoints to average; expected two at least")
    share = torch.ones(len(folders)) if shares is None else torch.as_tensor(list(shares), dtype=torch.float32)
    if len(share) != len(folders) or not bool(((share > 0) & share.isfinite()).all()):
        raise CheckpointError(f"shares={shares} of {len(folders)} checkpoints; expected as many positive numbers")
    if Path(out).resolve() in [Path(folder).resolve() for folder in folders]:
        raise CheckpointError(f"out={str(out)!r} is one of the checkpoints to average; expected another folder")
    loaded = [load_checkpoint(folder) for folder in folders]
    last, model = loaded[-1], _module(loaded[-1])
    parts = [_module(checkpoint).state_dict() for checkpoint in loaded]
    for other, part in zip(loaded, parts, strict=True):
        if other.kind != last.kind or _shapes(part) != _shapes(parts[-1]):
            raise CheckpointError(f"{other.folder} is of another kind or size than {last.folder}; expected the same")
    share = share / share.sum()
    mean = {
        name: torch.stack([w * part[name] for w, part in zip(share, parts, strict=True)]).sum(0)
        if value.is_floating_point()
        else value
        for name, value in parts[-1].items()
    }
    model.load_state_dict(mean)
    averaged = {str(folder): w for folder, w in zip(folders, share.tolist(), strict=True)}
    training = {**last.description["training"], "averaged": averaged}
    training["seen_tasks"] = _union(checkpoint.seen_tasks for checkpoint in loaded)
    training["seen_joints"] = _union(checkpoint.seen_joints for checkpoint in loaded)
    save_checkpoint(Path(out), model, last.kind, list(last.banks.values()), training, {})


def _module(checkpoint: Checkpoint) -> nn.Module:
    assert isinstance(checkpoint.model, nn.Module)
    return checkpoint.model


def _union(parts: Iterable[Iterable[str]]) -> list[str]:
    return list(dict.fromkeys(name for part in parts for name in part))


def _shapes(weights: Mapping[str, Tensor]) -> dict[str, torch.Size]:
    return {name: value.shape for name, value in weights.items()}
