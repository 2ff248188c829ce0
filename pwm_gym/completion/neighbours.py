"""Nearest points of batched clouds."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

__all__ = ["gather_points", "nearest_points"]


@torch.no_grad()
def nearest_points(queries: Tensor, points: Tensor, count: int = 1) -> Tensor:
    """Indices (B, m, count) of the points (B, n, 3) nearest to queries (B, m, 3), in no particular order.

    On a CPU k-d trees are faster than all distances, the more so for many points and few neighbours.
    """
    if queries.is_cuda:
        return torch.cdist(queries, points).topk(count, -1, largest=False, sorted=False).indices
    index = np.empty((*queries.shape[:2], count), np.int64)
    for b, (cloud, asked) in enumerate(zip(points.detach().numpy(), queries.detach().numpy(), strict=True)):
        _, found = cKDTree(cloud, balanced_tree=False, compact_nodes=False).query(asked, count)
        index[b] = found.reshape(index[b].shape)
    return torch.from_numpy(index)


def gather_points(values: Tensor, index: Tensor) -> Tensor:
    """Values (B, n, C) at indices (B, m, k): (B, m, k, C)."""
    batch = torch.arange(len(values), device=values.device)[:, None, None]
    return values[batch, index]
