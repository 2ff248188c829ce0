"""Attention over a few tokens, fast on a CPU."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional as F

__all__ = ["Block"]

_CAP = 40.0  # of attention scores, far beyond what occurs: their exponentials stay finite


class Block(nn.Module):
    """Pre-norm attention and MLP.

    Args:
        width: channels of a token.
        heads: attention heads.
        ratio: hidden width of the MLP over ``width``.
    """

    def __init__(self, width: int, heads: int, ratio: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, ratio * width), nn.GELU(), nn.Linear(ratio * width, width))

    def forward(self, tokens: Tensor, read: int | None = None, visible: Tensor | None = None) -> Tensor:
        """Tokens (B, T, C) -> (B, T, C), or the first ``read`` of them alone.

        Args:
            tokens: all that there are.
            read: how many are asked for; None asks for all.
            visible: 1 where a token (second dimension) sees another (third), 0 where not (B, T, T); None shows all.
        """
        mixed = self._mixed(self.qkv(self.norm1(tokens)), read, visible)
        tokens = tokens[:, :read] + self.out(mixed)
        return tokens + self.mlp(self.norm2(tokens))

    def _mixed(self, qkv: Tensor, read: int | None, visible: Tensor | None) -> Tensor:
        """What the first ``read`` tokens read (B, T, C) of queries, keys and values (B, T, 3 C).

        On a CPU PyTorch's own attention takes three times as long for so few tokens: its softmax is slow on short rows.
        """
        q, k, v = qkv.unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4).contiguous().flatten(1, 2).unbind()
        scores = (q.shape[-1] ** -0.5 * q[:, :read]) @ k.transpose(-1, -2)  # (B heads, T, T)
        weights = scores.clamp(-_CAP, _CAP).exp()
        if visible is not None:
            weights = (weights.unflatten(0, (-1, self.heads)) * visible[:, None, :read]).flatten(0, 1)
        sums = weights @ F.pad(v, (0, 1), value=1.0)  # the last column is the softmax's denominator
        mixed = sums[..., :-1] / sums[..., -1:]
        return mixed.unflatten(0, (-1, self.heads)).transpose(1, 2).flatten(2)
