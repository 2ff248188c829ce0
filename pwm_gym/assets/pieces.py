"""Convex pieces of a mesh, which is what the physics engine collides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pwm_gym.errors import PwmGymError

__all__ = ["PieceConfig", "convex_pieces", "surface_deviation"]

_SAMPLES = 4000  # points whose distance to a surface is measured
_SURFACE = 60_000  # points that stand for that surface: 1.3 mm apart on a can of 0.1 m
_HULL_VERTICES = 64  # PhysX takes no more on a GPU
_THINNEST = 0.0005  # metres: a thinner mesh has no hull that can be collided with
_SHORTEST = 0.0005  # metres between the vertices of a hull, about


@dataclass(frozen=True)
class PieceConfig:
    """How finely a mesh is cut into convex pieces."""

    convex_within: float = 0.006
    """A mesh whose convex hull is nearly nowhere further from its surface than this, in metres, stays in one piece."""
    threshold: float = 0.08
    """Concavity that CoACD leaves in a piece, of the mesh's size."""
    max_pieces: int = 20
    """Most pieces of one mesh."""
    resolution: int = 500
    """Samples of CoACD's measure of concavity."""
    iterations: int = 20
    """CoACD's search steps for each cut."""


def convex_pieces(mesh: trimesh.Trimesh, config: PieceConfig | None = None) -> list[trimesh.Trimesh]:
    """Convex meshes that together stand for ``mesh`` (metres).

    A mesh that nearly is its own convex hull gives the hull alone; the others are cut by CoACD (Wei et al., 2022).

    Raises:
        PwmGymError: ``mesh`` is flat, or CoACD is needed and not installed.
    """
    config = config or PieceConfig()
    if mesh.extents.min() < _THINNEST:
        raise PwmGymError(f"the mesh is {mesh.extents.min():.2g} m thin; expected a mesh that is not flat")
    hull = mesh.convex_hull
    if _depth(hull, mesh) <= config.convex_within:
        return [_simple_hull(hull)]
    return [_simple_hull(piece) for piece in _decompose(mesh, config)]


def surface_deviation(mesh: trimesh.Trimesh, pieces: list[trimesh.Trimesh]) -> float:
    """Mean distance in metres from points of ``mesh`` to the nearest point of the pieces' surfaces."""
    return float(_distances(mesh, trimesh.util.concatenate(pieces)).mean())


def _depth(hull: trimesh.Trimesh, mesh: trimesh.Trimesh) -> float:
    """How far the hull's surface is from the mesh's, metres: 99th percentile over the hull."""
    return float(np.percentile(_distances(hull, mesh), 99))


def _distances(mesh: trimesh.Trimesh, other: trimesh.Trimesh) -> np.ndarray:
    """Distances (S,) in metres from points on ``mesh`` to the surface of ``other``."""
    points = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)[0]
    surface = trimesh.sample.sample_surface(other, _SURFACE, seed=0)[0]
    return cKDTree(surface).query(points)[0]


def _simple_hull(piece: trimesh.Trimesh) -> trimesh.Trimesh:
    """Convex hull without edges below half a millimetre, and of at most :data:`_HULL_VERTICES` vertices."""
    vertices = _apart(piece.convex_hull.vertices)
    if len(vertices) > _HULL_VERTICES:
        furthest = (vertices @ _sphere(_HULL_VERTICES).T).argmax(0)  # in evenly spread directions
        vertices = vertices[np.unique(furthest)]
    try:
        return trimesh.Trimesh(vertices).convex_hull
    except Exception:  # a sliver that was thinner than the grid
        return piece.convex_hull


def _apart(vertices: np.ndarray) -> np.ndarray:
    """One of the vertices (V, 3) in each cell of a grid."""
    cells = np.round(vertices / _SHORTEST).astype(int)
    return vertices[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def _sphere(count: int) -> np.ndarray:
    """Evenly spread unit vectors (count, 3): a Fibonacci spiral."""
    height = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1)


def _decompose(mesh: trimesh.Trimesh, config: PieceConfig) -> list[trimesh.Trimesh]:
    try:
        import coacd
    except ImportError as error:
        raise PwmGymError('cutting a mesh needs coacd; install it with: pip install "pwm-gym[assets]"') from error
    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(mesh.vertices, mesh.faces),
        threshold=config.threshold,
        max_convex_hull=config.max_pieces,
        max_ch_vertex=_HULL_VERTICES,
        resolution=config.resolution,
        mcts_nodes=10,
        mcts_iterations=config.iterations,
        mcts_max_depth=2,
    )
    return [trimesh.Trimesh(vertices, faces) for vertices, faces in parts]
