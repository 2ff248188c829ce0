"""Completers: a partial cloud and where it was seen from in, the whole object out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch

from pwm_gym.completion.checkpoint import load_completion
from pwm_gym.completion.frame import LEAST, ViewerFrame
from pwm_gym.completion.network import CompletionNet
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import spacing, spread

__all__ = ["Completer", "Completion", "HullCompleter", "LearnedCompleter", "build_completer"]

_NEIGHBOURS, _STRAYS = 7, 0.02  # a stray point is among this share of those that are loneliest


@dataclass(frozen=True, eq=False)
class Completion:
    """A completed object."""

    points: np.ndarray
    """(n, 3) float32, metres, in the partial cloud's frame, in the order of farthest-point sampling."""
    error: float
    """Expected Chamfer distance from the true surface, metres; NaN where the completer does not tell."""


@runtime_checkable
class Completer(Protocol):
    """Completes an object's partial cloud."""

    def __call__(self, partial: np.ndarray, eye: np.ndarray, points: int = 2048) -> Completion:
        """Complete ``partial`` (m, 3), metres, seen from ``eye`` (3,) in the same frame, with so many points.

        Raises:
            PwmGymError: fewer than 32 points, or points that are not finite.
        """


class LearnedCompleter:
    """Completion by the network.

    What is seen may be turned about the line of sight, and each turn is completed a little differently. Of the union of
    several turns the loneliest points are dropped and the rest is thinned evenly: one turn's points crowd where the
    object is seen, and so lies their middle.

    Args:
        net: trained; it is put into evaluation mode.
        device: of the network.
        turns: of each cloud.

    Raises:
        PwmGymError: ``turns`` is less than 1.
    """

    def __init__(self, net: CompletionNet, device: str = "cpu", turns: int = 2) -> None:
        if turns < 1:
            raise PwmGymError(f"turns={turns}; expected at least 1")
        self.net, self.device, self.turns = net.to(device).eval(), device, turns

    def __call__(self, partial: np.ndarray, eye: np.ndarray, points: int = 2048) -> Completion:
        """Complete ``partial`` (m, 3), metres, seen from ``eye`` (3,) in the same frame, with so many points."""
        _check(partial, eye)
        seen = spread(partial, self.net.config.points[0])
        frame = ViewerFrame.of(seen, eye)
        frames = [frame.turn(2.0 * np.pi * k / self.turns) for k in range(self.turns)]
        with torch.inference_mode():
            clouds, doubt = self.net(torch.from_numpy(np.stack([f.enter(seen) for f in frames])).to(self.device))
        whole = [f.leave(cloud) for f, cloud in zip(frames, clouds[-1].cpu().numpy(), strict=True)]
        kept = _without_strays(np.concatenate(whole))
        return Completion(spread(kept, points), float(doubt.exp().mean()) * frame.size)


class HullCompleter:
    """The partial cloud's convex hull, with points spread over it: what completion is measured against."""

    def __call__(self, partial: np.ndarray, eye: np.ndarray, points: int = 2048) -> Completion:
        """Points on the convex hull of ``partial`` (m, 3)."""
        import trimesh

        _check(partial, eye)
        hull = trimesh.PointCloud(partial.astype(np.float64)).convex_hull
        samples, _ = trimesh.sample.sample_surface(hull, 2 * points, seed=0)
        return Completion(spread(samples, points), float("nan"))


def build_completer(completer: str | Completer) -> Completer:
    """A completer by name: "hull", "default" (the shipped network), or a checkpoint's folder; others stay as they are.

    Raises:
        UnknownNameError: there is no such folder.
        CheckpointError: what is there is no network.
    """
    if not isinstance(completer, str):
        return completer
    return HullCompleter() if completer == "hull" else LearnedCompleter(load_completion(completer)[0])


def _without_strays(points: np.ndarray) -> np.ndarray:
    """Points (n, 3) without the few that lie farthest from their neighbours, which an even thinning would all keep."""
    lonely = spacing(points, _NEIGHBOURS)
    kept: np.ndarray = points[lonely <= np.quantile(lonely, 1.0 - _STRAYS)]
    return kept


def _check(partial: np.ndarray, eye: np.ndarray) -> None:
    if np.ndim(partial) != 2 or np.shape(partial)[1] != 3:
        raise PwmGymError(f"the partial cloud has shape {np.shape(partial)}; expected (m, 3)")
    if len(partial) < LEAST:
        raise PwmGymError(f"the partial cloud has {len(partial)} points; expected at least {LEAST}")
    if not np.isfinite(partial).all():
        raise PwmGymError(f"the partial cloud holds {int((~np.isfinite(partial)).sum())} values that are not finite")
    if np.shape(eye) != (3,):
        raise PwmGymError(f"eye has shape {np.shape(eye)}; expected (3,)")
