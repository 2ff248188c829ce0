"""Layers of Point Transformer V3: patch attention, conditional position encoding, blocks, grid pooling.

Layer norm stands wherever Point Transformer V3 has batch norm (Sonata; paper, appendix "Model Details").
Features are flat: (T, C) for the T tokens of all scenes of a :class:`~pwm_gym.dynamics.paper.ptv3.level.Level`.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pwm_gym.dynamics.paper.ptv3.level import Level, Patches

__all__ = [
    "MLP",
    "Block",
    "DropPath",
    "GridPool",
    "GridUnpool",
    "PatchAttention",
    "PositionConv",
    "RelativeBias",
]


class MLP(nn.Sequential):
    """Linear, GELU, linear: (..., size) to (..., size)."""

    def __init__(self, size: int, ratio: int) -> None:
        super().__init__(nn.Linear(size, ratio * size), nn.GELU(), nn.Linear(ratio * size, size))


class DropPath(nn.Module):
    """Stochastic depth: in training, a scene skips a residual branch with probability ``rate``."""

    def __init__(self, rate: float) -> None:
        super().__init__()
        self.rate = rate

    def forward(self, branch: Tensor, level: Level) -> Tensor:
        """``branch`` (T, C), zero in the dropped scenes and scaled in the others so that its mean is kept."""
        if not self.training or self.rate == 0:
            return branch
        keep = torch.rand(len(level.counts), device=branch.device) >= self.rate  # (B,)
        scale = keep.to(branch.dtype) / (1 - self.rate)
        return branch * scale[level.batch].unsqueeze(1)


class RelativeBias(nn.Module):
    """Relative position encoding: a learned bias a head for each axis and each clipped distance in cells."""

    def __init__(self, heads: int, reach: int) -> None:
        super().__init__()
        self.reach = reach
        self.table = nn.Parameter(torch.empty(3, 2 * reach + 1, heads))
        nn.init.trunc_normal_(self.table, std=0.02)

    def forward(self, grid: Tensor) -> Tensor:
        """Biases (G, heads, P, P) of queries by keys at cells (G, P, 3)."""
        apart = grid.unsqueeze(2) - grid.unsqueeze(1)  # (G, P, P, 3) query - key
        index = apart.clamp(-self.reach, self.reach) + self.reach
        x, y, z = (F.embedding(index[..., i], self.table[i]) for i in range(3))
        return (x + y + z).permute(0, 3, 1, 2)


class PatchAttention(nn.Module):
    """Multi-head attention among the tokens of each patch."""

    def __init__(self, size: int, heads: int, patch: int, reach: int | None, bias: bool) -> None:
        """``reach``: cells beyond which the relative bias is constant; None for no relative bias."""
        super().__init__()
        self.heads = heads
        self.patch = patch
        self.qkv = nn.Linear(size, 3 * size, bias=bias)
        self.out = nn.Linear(size, size)
        self.relative = None if reach is None else RelativeBias(heads, reach)

    def forward(self, x: Tensor, level: Level, curve: int) -> Tensor:
        """Attended features (T, C) of ``x`` (T, C), in patches along a curve of the level."""
        patches = level.patches(curve, self.patch)
        # index_select here and below: on a GPU its backward pass adds at once, while that of [] sorts first.
        qkv = self.qkv(x).index_select(0, patches.tokens.flatten())  # (G * P, 3C)
        qkv = qkv.view(*patches.tokens.shape, 3, self.heads, -1)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)  # each (G, heads, P, C / heads)
        attended = F.scaled_dot_product_attention(q, k, v, self._mask(level, patches, q.dtype))
        flat = attended.transpose(1, 2).reshape(-1, x.shape[1])  # (G * P, C)
        return self.out(flat.index_select(0, patches.place))

    def _mask(self, level: Level, patches: Patches, dtype: torch.dtype) -> Tensor | None:
        """What is added to the logits (G, heads, P, P), or which keys count (G, 1, 1, P), or None."""
        valid = None if patches.valid is None else patches.valid[:, None, None]
        if self.relative is None:
            return valid
        bias = self.relative(level.grid[patches.tokens]).to(dtype)
        return bias if valid is None else bias.masked_fill(~valid, float("-inf"))


class PositionConv(nn.Module):
    """Conditional position encoding (PTv3's xCPE): submanifold 3 x 3 x 3 convolution, linear, layer norm.

    Outputs stand at occupied cells only, and empty cells add nothing. Tokens that share a cell (only at the
    finest level) enter it as their mean and read the same result.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(27, size, size))  # offset (x slowest), in, out
        bound = (27 * size) ** -0.5
        nn.init.uniform_(self.weight, -bound, bound)
        self.linear = nn.Linear(size, size)
        self.norm = nn.LayerNorm(size)

    def convolve(self, x: Tensor, level: Level) -> Tensor:
        """Convolved features (T, C) of ``x`` (T, C)."""
        near = level.neighbours
        cells = x.index_select(0, near.order)
        if len(near.sizes) < len(x):  # a sum over sorted segments is deterministic on every device
            cells = torch.segment_reduce(cells, "mean", lengths=near.sizes, unsafe=True)  # (V, C)
        weights = self.weight.unbind()
        result = cells @ weights[13]  # (V, C) the cell itself
        for i, (target, source) in enumerate(near.pairs):
            if i != 13:
                result.index_add_(0, target, cells.index_select(0, source) @ weights[i])
        return result.index_select(0, near.cell)

    def forward(self, x: Tensor, level: Level) -> Tensor:
        """Position encoding (T, C), to be added to ``x`` (T, C)."""
        return self.norm(self.linear(self.convolve(x, level)))


class Block(nn.Module):
    """Position encoding, attention and MLP, each a residual; layer norm before the last two (pre-norm)."""

    def __init__(
        self,
        size: int,
        heads: int,
        patch: int,
        *,
        position: str,
        reach: int,
        ratio: int,
        bias: bool,
        drop: float,
        curve: int,
    ) -> None:
        """``position`` is ``"cpe"`` or ``"rpe"``; ``curve`` is the index of the curve that patches follow."""
        super().__init__()
        self.curve = curve
        self.position = PositionConv(size) if position == "cpe" else None
        self.norm1 = nn.LayerNorm(size)
        self.attention = PatchAttention(size, heads, patch, reach if position == "rpe" else None, bias)
        self.norm2 = nn.LayerNorm(size)
        self.mlp = MLP(size, ratio)
        self.drop = DropPath(drop)

    def forward(self, x: Tensor, level: Level) -> Tensor:
        """Features (T, C) of ``x`` (T, C)."""
        if self.position is not None:
            x = x + self.position(x, level)
        x = x + self.drop(self.attention(self.norm1(x), level, self.curve), level)
        return x + self.drop(self.mlp(self.norm2(x)), level)


def _project(size: int, to: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(size, to), nn.LayerNorm(to), nn.GELU())


class GridPool(nn.Module):
    """Grid pooling: the largest projected features among the tokens of each coarse cell."""

    def __init__(self, size: int, to: int) -> None:
        super().__init__()
        self.linear = nn.Linear(size, to)
        self.norm = nn.LayerNorm(to)

    def forward(self, x: Tensor, parent: Tensor, count: int) -> Tensor:
        """Features (count, C') of the coarse tokens ``parent`` (T,) of ``x`` (T, C)."""
        x = self.linear(x)
        index = parent.unsqueeze(1).expand_as(x)
        pooled = x.new_zeros(count, x.shape[1]).scatter_reduce(0, index, x, "amax", include_self=False)
        return F.gelu(self.norm(pooled))


class GridUnpool(nn.Module):
    """Inverse of grid pooling: a token's own features and its coarse cell's, projected and added."""

    def __init__(self, size: int, skip: int, to: int) -> None:
        super().__init__()
        self.coarse = _project(size, to)
        self.skip = _project(skip, to)

    def forward(self, x: Tensor, parent: Tensor, skip: Tensor) -> Tensor:
        """Features (T, C') from coarse features ``x`` (T', C) and the encoder's ``skip`` (T, C'')."""
        return self.coarse(x).index_select(0, parent) + self.skip(skip)
