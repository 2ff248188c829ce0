"""One resolution of a batch of clouds: tokens on a grid, their orders along curves, patches, neighbours.

Scenes have different numbers of tokens after pooling, so tokens of all scenes stand in one flat list, scene
after scene, with ``counts`` tokens a scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from torch import Tensor

from pwm_gym.dynamics.paper.ptv3.serialization import encode

__all__ = ["Level", "Neighbours", "Patches"]


@dataclass(frozen=True, eq=False)
class Patches:
    """Groups of P consecutive tokens along a curve; attention stays inside a group."""

    tokens: Tensor
    """Tokens (G, P) of each group. A scene's last group reaches back into the one before it, to be full."""
    valid: Tensor | None
    """Which of ``tokens`` (G, P) are real; None where all are, as in scenes of at least P tokens."""
    place: Tensor
    """Where the result of each token (T,) stands among the G * P places."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Occupied cells in a sorted list, and the pairs of them that a 3 x 3 x 3 kernel joins."""

    order: Tensor
    """Tokens (T,) sorted by cell."""
    sizes: Tensor
    """Number of tokens (V,) in each cell."""
    cell: Tensor
    """Cell (T,) of each token."""
    pairs: tuple[tuple[Tensor, Tensor], ...]
    """For each of the 27 offsets, x slowest: (cells, their neighbours at that offset), both (m,)."""


@dataclass(frozen=True, eq=False)
class Level:
    """Tokens of a batch of B scenes at one resolution."""

    grid: Tensor
    """Cells (T, 3), int64 in [0, 2^depth)."""
    batch: Tensor
    """Scene (T,) of each token, in non-decreasing order."""
    counts: Tensor
    """Number of tokens (B,) of each scene, at least 1."""
    codes: Tensor
    """Codes (K, T) of the cells along K curves."""
    depth: int
    """Bits of a grid coordinate."""
    _patches: dict[tuple[int, int], Patches] = field(default_factory=dict, repr=False)

    @classmethod
    def build(
        cls, points: Tensor, batch: Tensor, scenes: int, grid_size: float, curves: Sequence[str], depth: int
    ) -> Level:
        """Finest level of ``points`` (T, 3), metres from their scene's centre, sorted by ``batch`` (T,).

        Tokens in one cell keep the order in which they come, so the caller sorts them
        (:func:`~pwm_gym.dynamics.paper.ptv3.serialization.merge_duplicates`). Points beyond the grid move to its
        border.
        """
        # A third of the range (binary 0.0101...) is as far as can be from the splits of the curves at every
        # scale: half the range would cut every curve at the scene's centre.
        origin = 2**depth // 3
        cells = torch.nan_to_num(points.detach().float() / grid_size).floor() + origin
        grid = cells.clamp(0, 2**depth - 1).long()  # (T, 3)
        counts = torch.bincount(batch, minlength=scenes)  # (B,)
        return cls(grid, batch, counts, encode(grid, curves, depth), depth)

    @cached_property
    def sizes(self) -> list[int]:
        """``counts`` on the host."""
        return self.counts.tolist()

    @cached_property
    def starts(self) -> Tensor:
        """First token (B,) of each scene."""
        return self.counts.cumsum(0) - self.counts

    def shuffle(self) -> Level:
        """The same tokens with the curves in random order (from torch's global generator)."""
        return replace(self, codes=self.codes[torch.randperm(len(self.codes))], _patches={})

    def order(self, curve: int) -> Tensor:
        """Tokens (T,) along a curve, scene after scene."""
        return ((self.batch << (3 * self.depth)) | self.codes[curve]).argsort(stable=True)

    def patches(self, curve: int, size: int) -> Patches:
        """Groups of at most ``size`` tokens along a curve (index taken modulo the number of curves)."""
        key = (curve % len(self.codes), size)
        if key not in self._patches:
            self._patches[key] = self._cut(self.order(key[0]), min(size, max(self.sizes)))
        return self._patches[key]

    def _cut(self, order: Tensor, size: int) -> Patches:
        groups = (self.counts + size - 1).div(size, rounding_mode="floor")  # (B,) groups of each scene
        first = groups.cumsum(0) - groups
        scene = torch.repeat_interleave(torch.arange(len(groups), device=order.device), groups)  # (G,)
        within = torch.arange(len(scene), device=order.device) - first[scene]
        last = (self.counts - size).clamp_min(0)  # (B,) where a scene's last group begins
        begin = torch.minimum(within * size, last[scene])  # (G,)
        rank = begin.unsqueeze(1) + torch.arange(size, device=order.device)  # (G, P) place in the scene's order
        count = self.counts[scene].unsqueeze(1)
        tokens = order[self.starts[scene].unsqueeze(1) + torch.minimum(rank, count - 1)]
        place = torch.empty_like(order)
        batch = self.batch[order]
        own = torch.arange(len(order), device=order.device) - self.starts[batch]  # (T,) rank of each token
        group = own.div(size, rounding_mode="floor")
        place[order] = (first[batch] + group) * size + own - torch.minimum(group * size, last[batch])
        return Patches(tokens, None if min(self.sizes) >= size else rank < count, place)

    @cached_property
    def neighbours(self) -> Neighbours:
        """Occupied cells and the pairs among them that are at most one cell apart on each axis."""
        bits = self.depth + 1  # room for the cells just outside the grid, so that no offset wraps around
        x, y, z = (self.grid + 1).unbind(-1)
        key = (((self.batch << bits | x) << bits | y) << bits) | z
        keys, cell = torch.unique(key, return_inverse=True)  # (V,) sorted, (T,)
        step = torch.tensor([-1, 0, 1], device=key.device)
        offsets = torch.cartesian_prod(step << (2 * bits), step << bits, step).sum(-1)  # (27,)
        target = keys + offsets.unsqueeze(1)  # (27, V)
        found = torch.searchsorted(keys, target).clamp_max(len(keys) - 1)
        match = keys[found] == target
        split = match.sum(1).tolist()
        pairs = zip(match.nonzero()[:, 1].split(split), found[match].split(split), strict=True)
        return Neighbours(cell.argsort(stable=True), torch.bincount(cell), cell, tuple(pairs))

    def pool(self) -> tuple[Level, Tensor]:
        """The level of twice the cell size, one token a cell, and the coarse token (T,) of each token."""
        depth = self.depth - 1
        # Codes of a curve identify cells, and their prefix the parent cells.
        key = (self.batch << (3 * depth)) | (self.codes[0] >> 3)
        keys, parent = torch.unique(key, return_inverse=True)
        child = torch.empty_like(keys)  # any one token of each coarse cell: all give the same cell
        child[parent] = torch.arange(len(key), device=key.device)
        batch = self.batch[child]
        counts = torch.bincount(batch, minlength=len(self.counts))
        return Level(self.grid[child] >> 1, batch, counts, self.codes[:, child] >> 3, depth), parent
