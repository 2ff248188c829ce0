"""What training may change of a window without changing what happens in it."""

from __future__ import annotations

import itertools
from dataclasses import replace

import torch
from torch import Tensor

from pwm_gym.data.batch import Batch, Batches

__all__ = ["Reframed", "reframe"]


def _axis_rotations() -> Tensor:
    """The 24 rotations (24, 3, 3) that take axes to axes."""
    signed = [
        torch.eye(3)[list(order)] * torch.tensor(signs).unsqueeze(1)
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return torch.stack([m for m in signed if torch.linalg.det(m) > 0])


_AXES = _axis_rotations()


class Reframed:
    """Windows whose objects' axes are named at random (:func:`reframe`)."""

    def __init__(self, windows: Batches) -> None:
        self._windows = windows

    def sample(self, generator: torch.Generator, batch: int, horizon: int) -> Batch:
        """``batch`` windows of ``horizon`` steps."""
        return reframe(self._windows.sample(generator, batch, horizon), generator)


def reframe(batch: Batch, generator: torch.Generator) -> Batch:
    """The same world points and motions with the axes of each object's canonical frame named anew.

    Which axis of an object is its x is a convention that dynamics must not depend on: a cube that has toppled lies like
    one that has not. Each object of each window draws one of the 24 rotations that take axes to axes, unless something
    hangs on it, whose joint is told in its axes.
    """
    parents = {entity.joint.parent for entity in batch.layout}
    clouds, frames, following = batch.clouds.clone(), batch.frames.clone(), batch.following.clone()
    for k, entity in enumerate(batch.layout):
        if not entity.loose or entity.name in parents:
            continue
        turn = _AXES[torch.randint(len(_AXES), (len(clouds),), generator=generator)]  # (B, 3, 3)
        clouds[:, entity.slice] = clouds[:, entity.slice] @ turn
        for poses in (frames, following):
            poses[:, :, k, :3, :3] = poses[:, :, k, :3, :3] @ turn.unsqueeze(1)
    return replace(batch, clouds=clouds, frames=frames, following=following)
