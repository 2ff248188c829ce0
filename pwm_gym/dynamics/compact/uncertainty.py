"""How far off a world model may be: the expected error of each step, told by what the model sees before it.

Fitted when the model is done: the head reads the frozen model's tokens and learns the mean error of single steps from
true states. Along a rollout the expected errors of its steps add up, times a factor: errors that are never corrected
grow like their sum, but not all in one direction.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

__all__ = ["ErrorHead"]

_UNIT = 1e-3  # metres
_RANGE = (-10.0, 4.0)  # of the logarithm of an expected error in units: 45 nm to 5.5 cm a step
_BATCH, _RATE = 1024, 2e-3


class ErrorHead(nn.Module):
    """What each step adds to the expected error of each entity.

    Args:
        width: channels of the tokens.
        hidden: channels of the hidden layer.
    """

    factor: Tensor

    def __init__(self, width: int, hidden: int = 64) -> None:
        super().__init__()
        self.register_buffer("factor", torch.ones(()))
        self.net = nn.Sequential(nn.Linear(width, hidden), nn.GELU(), nn.Linear(hidden, 1))
        self.requires_grad_(False)  # the model's own training leaves it alone

    def forward(self, tokens: Tensor) -> Tensor:
        """What a step adds (..., E) to the mean distance of an entity's points from the truth, metres.

        Args:
            tokens: of the step (..., E, C).
        """
        return self.factor * _UNIT * self._log(tokens).exp()

    def _log(self, tokens: Tensor) -> Tensor:
        return self.net(tokens).squeeze(-1).clamp(*_RANGE)

    def fit(self, tokens: Tensor, errors: Tensor, steps: int, seed: int = 0) -> None:
        """Most likely scales of exponentially distributed errors, by gradient descent.

        Args:
            tokens: of transitions (M, E, C).
            errors: what the model missed by (M, E), metres.
            steps: optimiser steps.
            seed: of the batches.
        """
        self.requires_grad_(True)
        optimizer = torch.optim.AdamW(self.parameters(), _RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, steps))
        generator = torch.Generator().manual_seed(seed)
        for _ in range(steps):
            index = torch.randint(len(tokens), (_BATCH,), generator=generator)
            log = self._log(tokens[index])
            loss = (errors[index] / _UNIT * (-log).exp() + log).mean()
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            nn.utils.clip_grad_norm_(self.parameters(), 1.0)
            optimizer.step()
            schedule.step()
        self.requires_grad_(False)
