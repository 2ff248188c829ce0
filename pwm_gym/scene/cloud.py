"""Canonical clouds: points sampled once on an entity's mesh, in its own frame (paper, appendix "Data Generation")."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from pwm_gym.errors import SceneError
from pwm_gym.scene.layout import Layout

if TYPE_CHECKING:
    import trimesh

__all__ = ["reordered", "resample_clouds", "sample_clouds", "sample_surface", "spacing", "spread"]

_HEIGHT = 5  # of the tree that saves most distances of a few thousand points
_CANDIDATES = 8  # surface samples per kept point, from which farthest-point sampling chooses


def sample_surface(mesh: trimesh.Trimesh, count: int, seed: int) -> np.ndarray:
    """``count`` points (count, 3) spread over ``mesh``, float32, in the order of farthest-point sampling.

    Every prefix is itself well spread, so a coarser cloud is the first points of a finer one.
    """
    import fpsample
    import trimesh

    candidates, _ = trimesh.sample.sample_surface(mesh, count * _CANDIDATES, seed=seed)
    candidates = np.ascontiguousarray(candidates, dtype=np.float32)
    order = fpsample.fps_sampling(candidates, count, start_idx=0)
    return candidates[order]


def sample_clouds(meshes: Mapping[str, trimesh.Trimesh], layout: Layout, seed: int) -> np.ndarray:
    """Canonical points (N, 3) of every entity of ``layout``, float32, from meshes in their own frames (metres)."""
    missing = [name for name in layout.names if name not in meshes]
    if missing:
        raise SceneError(f"no mesh for {', '.join(missing)}; got {', '.join(meshes) or 'none'}")
    parts = [sample_surface(meshes[e.name], e.points, seed + i) for i, e in enumerate(layout)]
    return np.concatenate(parts)


def resample_clouds(clouds: np.ndarray, full: Layout, layout: Layout) -> np.ndarray:
    """Coarser canonical points of ``layout`` from those of ``full``: each entity's first points."""
    return clouds[full.kept(layout)]


def reordered(points: np.ndarray, start: int, leading: int) -> np.ndarray:
    """The points of a cloud (m, 3) in another order: well-spread ones first, then the rest as they were.

    Args:
        points: the cloud.
        start: place of the point that comes first.
        leading: how many are in the order of farthest-point sampling; all where the cloud has fewer.
    """
    import fpsample

    first = fpsample.fps_sampling(np.ascontiguousarray(points, np.float32), min(leading, len(points)), start_idx=start)
    return np.concatenate([points[first], np.delete(points, first, axis=0)])


def spacing(points: np.ndarray, neighbours: int) -> np.ndarray:
    """Mean distance (m,) of each point of a cloud (m, 3) to so many nearest others, or to all where there are fewer."""
    if len(points) < 2:
        return np.zeros(len(points))
    distance, _ = cKDTree(points).query(points, k=range(2, min(neighbours, len(points) - 1) + 2))
    return distance.mean(1)


def spread(points: np.ndarray, count: int, rng: np.random.Generator | None = None) -> np.ndarray:
    """``count`` points (count, 3) of a cloud (m, 3) in the order of farthest-point sampling, or all of them repeated.

    Args:
        points: the cloud.
        count: how many.
        rng: chooses four times as many first, where the cloud has more still; without it all count.
    """
    import fpsample

    if rng is not None and len(points) > 4 * count:
        points = points[rng.choice(len(points), 4 * count, replace=False)]
    points = np.ascontiguousarray(points, np.float32)
    kept = min(count, len(points))
    if len(points) < 2**_HEIGHT:
        order = fpsample.fps_sampling(points, kept, start_idx=0)
    else:
        order = fpsample.bucket_fps_kdline_sampling(points, kept, _HEIGHT, start_idx=0)
    return points[order[np.arange(count) % len(order)]]
