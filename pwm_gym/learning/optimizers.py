"""Optimisers of training: AdamW, or Muon on large matrices and AdamW on the rest."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

__all__ = ["Optimizer", "build_optimizer"]

_LARGE = 32  # rows and columns; most matrices with fewer are tables, inputs or outputs, which Muon is not for


class Optimizer:
    """Several PyTorch optimisers, each of its own parameters, as one."""

    def __init__(self, *parts: torch.optim.Optimizer) -> None:
        self._parts = parts

    def set_learning_rate(self, rate: float) -> None:
        """Of all parameters."""
        for part in self._parts:
            for group in part.param_groups:
                group["lr"] = rate

    def zero_grad(self) -> None:
        """Drop all gradients."""
        for part in self._parts:
            part.zero_grad(set_to_none=True)

    def step(self) -> None:
        """One update of all parameters."""
        for part in self._parts:
            part.step()

    def state_dict(self) -> list[dict[str, Any]]:
        """State to resume from."""
        return [part.state_dict() for part in self._parts]

    def load_state_dict(self, state: list[dict[str, Any]]) -> None:
        """Resume from a :meth:`state_dict`."""
        for part, own in zip(self._parts, state, strict=True):
            part.load_state_dict(own)


def build_optimizer(model: nn.Module, learning_rate: float, weight_decay: float, muon: bool) -> Optimizer:
    """The optimiser of a model's parameters.

    Args:
        model: to train.
        learning_rate: of all parameters.
        weight_decay: of all parameters.
        muon: whether Muon (Jordan et al., 2024; its updates as large as AdamW's: Liu et al., 2025) orthogonalises the
            updates of matrices of at least 32 x 32; AdamW has all other parameters.
    """
    parameters = list(model.parameters())
    matrices = [p for p in parameters if muon and p.ndim == 2 and min(p.shape) >= _LARGE]
    chosen = {id(p) for p in matrices}
    others = [p for p in parameters if id(p) not in chosen]
    parts: list[torch.optim.Optimizer] = []
    if others:
        parts.append(torch.optim.AdamW(others, lr=learning_rate, weight_decay=weight_decay))
    if matrices:
        parts.append(torch.optim.Muon(matrices, learning_rate, weight_decay, adjust_lr_fn="match_rms_adamw"))
    return Optimizer(*parts)
