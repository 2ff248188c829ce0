"""Multi-step supervised training of world models (paper, section 3, "Training Objective")."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.data.batch import Batch, Batches
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.dynamics.protocols import MovesArms, ReadsPoints
from pwm_gym.errors import unknown_name
from pwm_gym.learning import Clock, LoopConfig, run_training
from pwm_gym.scene import Layout, RigidState, State

__all__ = ["TrainConfig", "rollout_loss", "train"]

_LOSSES = ("huber", "hybrid")
_LEVER = 0.5  # metres: how far a joint moves the end effector, per radian


@dataclass(frozen=True)
class TrainConfig(LoopConfig):
    """How to train. The defaults train the compact model; :meth:`paper` gives the paper's table."""

    phases: tuple[tuple[int, int, int], ...] = ((1, 6000, 256), (5, 1200, 256), (15, 450, 192))
    """(horizon H, optimiser steps, batch size), one after the other."""
    loss: str = "huber"
    """"huber" on each point's motion, or "hybrid": Chamfer plus Hausdorff distance to what a camera sees, without
    correspondences (ParticleFormer's; their weights are not stated, and equal here)."""
    huber_delta: float = 0.25
    """Huber's delta, in units of ``loss_scale`` metres."""
    loss_scale: float = 0.002
    """Metres that count as 1 in the loss; the paper's loss is on metres (1.0)."""
    position_weight: float = 0.1
    """Weight of the same loss on positions (0 in the paper: velocities alone)."""
    joint_weight: float = 0.1
    """Weight of the same loss on joint positions and velocities (times half a metre), for models that move them."""
    object_weight: float = 2.0
    """Weight of the points of entities that the robot does not drive."""
    loss_points: int = 32
    """Points of each entity in the loss (a model that reads points of them always gets as many)."""

    def __post_init__(self) -> None:
        """Raise :class:`UnknownNameError` for an optimiser, a schedule or a loss that is none."""
        super().__post_init__()
        if self.loss not in _LOSSES:
            raise unknown_name("loss", self.loss, _LOSSES)

    @classmethod
    def paper(cls, steps: int = 100_000, batch: int = 32) -> TrainConfig:
        """The paper's table: Huber(0.25) on velocities over H = 15, AdamW 1e-4, StepLR(30, 0.1)."""
        return cls(
            phases=((15, steps, batch),),
            optimizer="adamw",
            learning_rate=1e-4,
            schedule="step",
            loss_scale=1.0,
            position_weight=0.0,
            joint_weight=0.0,
            object_weight=1.0,
            loss_points=10**9,
            ema_decay=0.0,
        )


class _RolloutLoss(nn.Module):
    """Loss of one batch as a module, so that DistributedDataParallel sees one forward a step."""

    def __init__(self, model: nn.Module, config: TrainConfig) -> None:
        super().__init__()
        self.model, self.config = model, config

    def forward(self, batch: Batch) -> Tensor:
        return rollout_loss(self.model, batch, self.config)  # type: ignore[arg-type]


def rollout_loss(model: WorldModel, batch: Batch, config: TrainConfig) -> Tensor:
    """Mean loss over H predicted steps, in ``loss_scale`` units; ``config.loss`` says which."""
    few = batch.layout.truncate(_points_in_loss(model, config))
    state: State = model.prepare(batch.state().coarsen(few))
    target = RigidState(state.layout, state.clouds, batch.frames)
    weight = _point_weights(state.layout, config.object_weight, batch.frames.device)
    terms: list[Tensor] = []
    points, truth = state.points(), target.points()
    for h, action in enumerate(batch.actions.unbind(1)):
        state, target = model.step(state, action), target.advance(batch.following[:, h])
        next_points, next_truth = state.points(), target.points()
        if config.loss == "hybrid":
            seen = next_truth if batch.observed is None else batch.observed[:, h]
            term = _hybrid(next_points, seen) / config.loss_scale
        else:
            term = _huber((next_points - points) - (next_truth - truth), config, weight)
            if config.position_weight:
                term = term + config.position_weight * _huber(next_points - next_truth, config, weight)
            joints = state.joints if isinstance(state, RigidState) else None
            if config.joint_weight and isinstance(model, MovesArms) and joints is not None:
                error = joints - model.own_joints(batch.following_joints[:, h])
                term = term + config.joint_weight * _huber(_LEVER * error, config)
        terms.append(term)
        points, truth = next_points, next_truth
    return torch.stack(terms).mean()


def _points_in_loss(model: WorldModel, config: TrainConfig) -> int:
    """Points of each entity that a rollout carries: enough for the loss and for what the model reads (0: all)."""
    read = model.read_points if isinstance(model, ReadsPoints) else config.loss_points
    return max(config.loss_points, read) if read else 10**9


def _point_weights(layout: Layout, object_weight: float, device: torch.device) -> Tensor:
    """Weights (N, 1) of mean 1: entities that the robot does not drive count ``object_weight`` times as much."""
    driven = torch.tensor([e.driven for e in layout.entities], device=device)[torch.as_tensor(layout.ids)]
    weight = torch.where(driven, 1.0, object_weight).unsqueeze(-1)
    return weight / weight.mean()


def _hybrid(predicted: Tensor, observed: Tensor) -> Tensor:
    """Symmetric Chamfer plus Hausdorff distance, metres, of clouds (B, n, 3) and (B, m, 3); mean of the batch."""
    gaps = torch.cdist(predicted, observed)
    there, back = gaps.amin(2), gaps.amin(1)
    chamfer = 0.5 * (there.mean(1) + back.mean(1))
    return (chamfer + torch.maximum(there.amax(1), back.amax(1))).mean()


def _huber(error: Tensor, config: TrainConfig, weight: Tensor | float = 1.0) -> Tensor:
    """Weighted mean Huber loss of errors (B, ...) in metres."""
    scaled = error / config.loss_scale
    zero = torch.zeros_like(scaled)
    return (F.huber_loss(scaled, zero, reduction="none", delta=config.huber_delta) * weight).mean()


def train(
    model: nn.Module,
    batches: Batches,
    config: TrainConfig,
    folder: Path,
    validate: Callable[[Any], dict[str, float]],
    save: Callable[[nn.Module, dict[str, float]], None],
    progress: bool = True,
    clock: Clock | None = None,
) -> dict[str, float]:
    """Train ``model`` and return the last validation's metrics (empty in all processes but the first).

    Args:
        model: a world model; it is changed in place and holds the averaged weights at the end.
        batches: training windows.
        config: settings.
        folder: TensorBoard curves and the training state; a state found there is resumed.
        validate: metrics of a model, by rollouts of validation episodes.
        save: writes a checkpoint of a model with its metrics.
        progress: whether to show a bar.
        clock: counts what all sessions of the training took.
    """

    def draw(generator: torch.Generator, step: int, processes: int) -> Batch:
        horizon, size = config.phase(step)
        return batches.sample(generator, max(1, size // processes), horizon)

    return run_training(model, _RolloutLoss(model, config), draw, config, folder, validate, save, progress, clock)
