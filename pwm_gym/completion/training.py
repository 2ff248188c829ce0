"""Training of the completion network: Chamfer loss at each level (paper, appendix)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.completion.neighbours import gather_points, nearest_points
from pwm_gym.completion.network import CompletionNet
from pwm_gym.completion.views import Batch, Views
from pwm_gym.learning import Clock, LoopConfig, run_training

__all__ = ["CompletionLoss", "CompletionTrainConfig", "chamfer_loss", "train_completion"]


@dataclass(frozen=True)
class CompletionTrainConfig(LoopConfig):
    """How to train. The defaults train the compact network."""

    phases: tuple[tuple[int, int, int], ...] = ((1, 2500, 32), (3, 1300, 16))
    """(steps of the decoder, optimiser steps, batch size), one after the other: the first levels alone are trained in a
    fraction of the time."""
    learning_rate: float = 2e-3
    """The optimiser's, at its highest."""
    validate_every: int = 1000
    """Optimiser steps between validations; a checkpoint is saved then, too."""
    target: int = 1024
    """Points of each object's surface in the loss."""
    doubt_weight: float = 0.05
    """Weight of the loss of the expected error."""


class CompletionLoss(nn.Module):
    """Sum of the Chamfer distances of all levels, and the error of the expected one."""

    def __init__(self, net: CompletionNet, doubt_weight: float) -> None:
        super().__init__()
        self.net, self.doubt_weight = net, doubt_weight

    def forward(self, batch: Batch) -> Tensor:
        """Loss of one batch."""
        clouds, doubt = self.net(batch.partial, batch.steps)
        gaps = torch.stack([chamfer_loss(cloud, batch.target) for cloud in clouds])  # (levels, B)
        told = F.smooth_l1_loss(doubt, gaps[-1].detach().log(), beta=0.2)
        loss = gaps.sum(0).mean() + self.doubt_weight * told
        if dist.is_initialized() and batch.steps is not None:  # it wants to see every parameter
            idle = self.net.decoder[batch.steps :].parameters()
            loss = loss + 0.0 * sum((p.sum() for p in idle), loss.new_zeros(()))
        return loss


def chamfer_loss(cloud: Tensor, target: Tensor) -> Tensor:
    """Euclidean Chamfer distance (B,) of clouds (B, n, 3) and (B, m, 3), half of both directions' sum.

    Only points and their nearest ones are in the gradient, and in memory.
    """
    forward = cloud - gather_points(target, nearest_points(cloud, target)).squeeze(2)
    backward = target - gather_points(cloud, nearest_points(target, cloud)).squeeze(2)
    there, back = ((x.square().sum(-1) + 1e-12).sqrt().mean(1) for x in (forward, backward))
    return 0.5 * (there + back)


def train_completion(
    net: CompletionNet,
    views: Views,
    config: CompletionTrainConfig,
    folder: Path,
    validate: Callable[[Any], dict[str, float]],
    save: Callable[[nn.Module, dict[str, float]], None],
    progress: bool = True,
    clock: Clock | None = None,
) -> dict[str, float]:
    """Train ``net`` on random views and return the last validation's metrics.

    Args:
        net: it is changed in place.
        views: of the training objects.
        config: how.
        folder: TensorBoard curves and the training state; a state found there is resumed.
        validate: metrics of a network.
        save: writes a checkpoint of a network with its metrics.
        progress: whether to show a bar.
        clock: counts what all sessions of the training took.
    """

    def draw(generator: torch.Generator, step: int, processes: int) -> Batch:
        steps, size = config.phase(step)
        rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        batch = views.batch(rng, max(1, size // processes), net.config.points[0], config.target)
        return replace(batch, steps=steps)

    loss = CompletionLoss(net, config.doubt_weight)
    return run_training(net, loss, draw, config, folder, validate, save, progress, clock)
