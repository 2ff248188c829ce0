"""Metrics on point clouds and poses. Lengths in metres."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import rankdata

__all__ = ["chamfer", "nearest_distances", "pearson", "spearman"]


def chamfer(a: np.ndarray, b: np.ndarray, order: int = 1) -> float:
    """Symmetric Chamfer distance between clouds (n, 3) and (m, 3), metres.

    Half the sum of both directions' mean nearest distances; ``order`` 1 sums absolute coordinates (the paper's
    Chamfer L1), 2 is Euclidean.
    """
    there, back = nearest_distances(a, b, order)
    return 0.5 * float(there.mean() + back.mean())


def nearest_distances(a: np.ndarray, b: np.ndarray, order: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Distances in metres, (n,) of points ``a`` (n, 3) to the nearest of ``b`` (m, 3), and (m,) the other way."""
    there, _ = cKDTree(b).query(a, p=order)
    back, _ = cKDTree(a).query(b, p=order)
    return there, back


def pearson(a: np.ndarray, b: np.ndarray) -> float | None:
    """Pearson correlation of two series; None where one of them does not vary."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)  # in float32 a constant's deviation is not 0
    if len(a) < 2 or a.std() < 1e-9 or b.std() < 1e-9:
        return None
    return float(np.corrcoef(a, b)[0, 1])


def spearman(a: np.ndarray, b: np.ndarray) -> float | None:
    """Spearman's rank correlation of two series; None where one of them does not vary."""
    return pearson(rankdata(a), rankdata(b))
