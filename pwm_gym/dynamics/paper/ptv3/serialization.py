"""Points in a line: codes of grid cells along space-filling curves, and an order that the set alone decides.

Source: Point Transformer V3 ("serialization": Z-order and Hilbert curves and their transposed variants). The
Hilbert index follows J. Skilling, "Programming the Hilbert curve" (2004).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from pwm_gym.errors import unknown_name

__all__ = ["CURVES", "canonical_order", "encode", "hilbert", "merge_duplicates", "z_order"]

# (shift, mask) pairs that move the bits of a 21-bit integer three places apart, in five doublings.
_SPREAD = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def _interleave(grid: Tensor) -> Tensor:
    """Codes (...) whose bits are those of x, y, z of ``grid`` (..., 3) in turn, x's the most significant."""
    bits = grid
    for shift, mask in _SPREAD:
        bits = (bits | (bits << shift)) & mask
    x, y, z = bits.unbind(-1)
    return (x << 2) | (y << 1) | z


def z_order(grid: Tensor, depth: int) -> Tensor:
    """Z-order (Morton) codes (...), int64, of cells (..., 3) in [0, 2^depth); ``depth`` is at most 21."""
    return _interleave(grid)


def hilbert(grid: Tensor, depth: int) -> Tensor:
    """Hilbert codes (...), int64, of cells (..., 3) in [0, 2^depth): consecutive codes are adjacent cells."""
    axes = list(grid.unbind(-1))
    for bit in range(depth - 1, 0, -1):  # undo the reflections and rotations of each octant, coarsest first
        low = (1 << bit) - 1
        for i in range(3):
            upper = (axes[i] >> bit) & 1 == 1
            swap = (axes[0] ^ axes[i]) & low
            first = torch.where(upper, axes[0] ^ low, axes[0] ^ swap)
            if i > 0:
                axes[i] = torch.where(upper, axes[i], axes[i] ^ swap)
            axes[0] = first
    axes[1] = axes[1] ^ axes[0]  # Gray code
    axes[2] = axes[2] ^ axes[1]
    flip = torch.zeros_like(axes[2])
    for bit in range(depth - 1, 0, -1):
        flip = torch.where((axes[2] >> bit) & 1 == 1, flip ^ ((1 << bit) - 1), flip)
    return _interleave(torch.stack(axes, -1) ^ flip.unsqueeze(-1))


def _transposed(curve: Callable[[Tensor, int], Tensor]) -> Callable[[Tensor, int], Tensor]:
    """``curve`` with x and y exchanged."""
    return lambda grid, depth: curve(grid[..., [1, 0, 2]], depth)


CURVES: dict[str, Callable[[Tensor, int], Tensor]] = {
    "z": z_order,
    "z-trans": _transposed(z_order),
    "hilbert": hilbert,
    "hilbert-trans": _transposed(hilbert),
}
"""Curves by name: cells (..., 3) and bits an axis -> codes (...). ``code >> 3`` tells the parent cell."""


def encode(grid: Tensor, curves: Sequence[str], depth: int) -> Tensor:
    """Codes (K, ...) of cells (..., 3), int64 in [0, 2^depth), along each of the K named curves."""
    for name in curves:
        if name not in CURVES:
            raise unknown_name("curve", name, tuple(CURVES))
    return torch.stack([CURVES[name](grid, depth) for name in curves])


def canonical_order(rows: Tensor) -> Tensor:
    """Indices (B, N) that sort the rows (B, N, C) of each scene by their first column, then the second, ...

    A stable sort by curve code after it breaks ties by coordinates, so the result does not depend on the
    order in which the points came.
    """
    index = torch.arange(rows.shape[1], device=rows.device).expand(rows.shape[:2])  # (B, N)
    for column in reversed(rows.unbind(-1)):
        index = index.gather(1, column.gather(1, index).argsort(dim=1, stable=True))
    return index


def merge_duplicates(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Distinct rows of each batch element of ``rows`` (B, N, C), in canonical order.

    Returns:
        index (T,) into the B * N rows of one representative a distinct row, sorted by batch element; and for
        each of the B * N rows the place (B * N,) of its representative among the T.
    """
    scenes, count, _ = rows.shape
    order = canonical_order(rows)
    ranked = rows.gather(1, order.unsqueeze(-1).expand_as(rows))
    new = torch.ones_like(order, dtype=torch.bool)  # (B, N) differs from the row before it
    new[:, 1:] = (ranked[:, 1:] != ranked[:, :-1]).any(-1)
    flat = (order + torch.arange(scenes, device=rows.device).unsqueeze(1) * count).flatten()  # (B * N,)
    place = torch.empty_like(flat)
    place[flat] = new.flatten().cumsum(0) - 1
    return flat[new.flatten()], place
