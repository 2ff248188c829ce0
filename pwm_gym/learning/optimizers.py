"""Optimisers of training: AdamW, or Muon on large matrices and AdamW on the rest."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn

__all__ = ["Muon", "Optimizer", "build_optimizer", "orthogonalised"]

_LARGE = 32  # rows and columns; most matrices with fewer are tables, inputs or outputs, which Muon is not for


_MOMENTUM, _ROUNDS, _TINY = 0.95, 5, 1e-7
_QUINTIC = (3.4445, -4.7750, 2.0315)  # of Newton and Schulz's iteration (Jordan et al., 2024)
_RMS = 0.2  # of AdamW's updates (Liu et al., 2025)


class Muon(torch.optim.Optimizer):
    """Momentum whose updates are orthogonalised, in the parameters' own precision.

    PyTorch's own rounds to bfloat16, which a CPU without such instructions emulates: an update of the default model's
    25 matrices took 230 ms of a training step of 370 ms (one core of a 2-core server), and takes 25 ms here.

    Args:
        params: matrices.
        lr: learning rate; updates are as large as AdamW's would be.
        weight_decay: share of the weights, times the learning rate, that a step takes off.
    """

    def __init__(self, params: Iterable[torch.nn.Parameter], lr: float, weight_decay: float) -> None:
        super().__init__(params, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        """One update of all matrices that have a gradient."""
        for group in self.param_groups:
            for matrix in group["params"]:
                if matrix.grad is None:
                    continue
                momentum = self.state[matrix].setdefault("momentum", torch.zeros_like(matrix))
                momentum.lerp_(matrix.grad, 1.0 - _MOMENTUM)
                update = orthogonalised(matrix.grad.lerp(momentum, _MOMENTUM))  # Nesterov's look ahead
                matrix.mul_(1.0 - group["lr"] * group["weight_decay"])
                matrix.add_(update, alpha=-_RMS * group["lr"] * max(matrix.shape) ** 0.5)


def orthogonalised(matrix: Tensor) -> Tensor:
    """A matrix (n, m) with nearly the same singular vectors, and singular values of about 1."""
    tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if tall else matrix
    x = x / x.norm().clamp_min(_TINY)
    a, b, c = _QUINTIC
    for _ in range(_ROUNDS):
        gram = x @ x.T
        x = torch.addmm(x, torch.addmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x.T if tall else x


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
        parts.append(Muon(matrices, learning_rate, weight_decay))
    return Optimizer(*parts)
