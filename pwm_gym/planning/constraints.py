"""Penalties that a planner may add to any cost; functions ``(points, info) -> (B,)``, zero where all is well."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from pwm_gym.costs import Points
from pwm_gym.costs.registry import Function, Info
from pwm_gym.errors import PwmGymError

__all__ = ["keep_clear", "workspace"]

_READ = 64  # points of each entity between which distances are measured


def workspace(low: Sequence[float], high: Sequence[float], entities: Sequence[str]) -> Function:
    """How far, in metres, the farthest point of each of ``entities`` is outside a box, summed.

    Args:
        low: lowest corner (3,), base frame.
        high: highest corner (3,).
        entities: names.

    Raises:
        PwmGymError: the corners are no box.
    """
    if len(low) != 3 or len(high) != 3 or any(not a < b for a, b in zip(low, high, strict=True)):
        raise PwmGymError(f"workspace from {tuple(low)} to {tuple(high)}; expected three coordinates, low below high")

    def outside(points: Points, info: Info) -> Tensor:
        total = torch.zeros_like(info["action"][..., 0])
        for name in entities:
            x = points[name]
            beyond = torch.maximum(x.new_tensor(low) - x, x - x.new_tensor(high)).clamp_min(0.0)
            total = total + beyond.amax(-1).amax(-1)
        return total

    return outside


def keep_clear(obstacles: Sequence[str], entities: Sequence[str], distance: float = 0.02) -> Function:
    """How much nearer than ``distance`` metres each of ``entities`` is to each obstacle, as a share of it, summed.

    Distances are between up to 64 points of each, which lie a centimetre apart on a cube of 4 cm: surfaces that touch
    may count as up to 1 cm apart, so that a smaller ``distance`` may not be felt.

    The paper's planner penalises collisions with clutter (appendix, "Sim2Real in Cluttered Environment").

    Args:
        obstacles: names of what is not to be touched.
        entities: names of what moves.
        distance: at which the penalty begins, metres.

    Raises:
        PwmGymError: a distance that is not positive, or an entity on both sides.
    """
    if not distance > 0.0:
        raise PwmGymError(f"distance={distance}; expected more than 0 metres")
    if both := sorted({*obstacles} & {*entities}):
        raise PwmGymError(f"{', '.join(both)} cannot keep clear of itself")

    def nearness(points: Points, info: Info) -> Tensor:
        total = torch.zeros_like(info["action"][..., 0])
        for obstacle in obstacles:
            for name in entities:
                apart = torch.cdist(points[name][:, :_READ], points[obstacle][:, :_READ]).amin((-1, -2))
                total = total + (1.0 - apart / distance).clamp_min(0.0)
        return total

    return nearness
