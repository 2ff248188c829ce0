"""Building blocks of random solids: lofts, sweeps, prisms, lathes, level sets and deformations.

Solids are ``manifold3d.Manifold``: closed by construction, with exact unions (``a + b``) and differences (``a - b``).
An invalid one stays invalid through all that is made of it, so only the end result has to be checked. Lengths have no
unit: shapes are brought to one size at the end.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold, Mesh64, triangulate
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from pwm_gym.errors import PwmGymError

__all__ = [
    "bend",
    "capsule",
    "cylinder",
    "level_set",
    "loft",
    "prism",
    "regular",
    "revolve",
    "rod",
    "rounded_box",
    "rounded_ends",
    "section",
    "shear_taper",
    "shell",
    "smooth_curve",
    "soften",
    "strip",
    "superquadric",
    "top",
    "tube",
    "twist",
    "union",
    "warp",
]

_SIDES = 40  # of a circle, unless told: a circle's chords stay within 0.3 % of its radius


def union(parts: Sequence[Manifold]) -> Manifold:
    """All ``parts`` as one solid."""
    return sum(parts[1:], start=parts[0])


def top(solid: Manifold) -> float:
    """Height of the highest point of ``solid``."""
    return float(solid.bounding_box()[5])


def loft(rings: np.ndarray, cap: np.ndarray | None = None, closed: bool = False) -> Manifold:
    """Skin over ``rings`` (K, N, 3), each counter-clockwise seen from where the next ring lies.

    Args:
        rings: cross-sections, one after the other.
        cap: triangles (M, 3) of indices into a ring, for its two ends; None for convex rings.
        closed: the last ring joins the first, without ends.
    """
    count, sides, _ = rings.shape
    corner = np.arange(sides)
    row = np.arange(count if closed else count - 1)[:, None] * sides
    a, b = row + corner, row + (corner + 1) % sides
    c, d = (b + sides) % (count * sides), (a + sides) % (count * sides)
    faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    if not closed:
        cap = np.stack([0 * corner[2:], corner[1:-1], corner[2:]], -1) if cap is None else cap
        faces += [cap[:, ::-1], cap + (count - 1) * sides]
    return _solid(rings.reshape(-1, 3), np.concatenate(faces))


def section(sides: int = 24, exponent: float = 2.0) -> np.ndarray:
    """Superellipse (sides, 2) of half-widths 1: 2 is a circle, above it nears a square, below it a rhombus."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    wave = np.stack([np.cos(angle), np.sin(angle)], -1)
    return np.sign(wave) * np.abs(wave) ** (2 / exponent)


def tube(path: np.ndarray, radii: np.ndarray, sides: int = 16, exponent: float = 2.0, closed: bool = False) -> Manifold:
    """Sweep of a superellipse along ``path`` (K, 2) in the plane of x and z.

    Args:
        path: points (x, z).
        radii: half-widths (2,) or (K, 2), across the plane (along y) and within it.
        sides: of a section.
        exponent: see ``section``.
        closed: the path is a loop; its first point is not repeated.
    """
    steps = np.roll(path, -1, 0) - np.roll(path, 1, 0) if closed else np.gradient(path, axis=0)
    along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    outline = section(sides, exponent) * np.broadcast_to(radii, path.shape)[:, None]
    rings = np.empty((len(path), sides, 3))
    rings[..., 0] = path[:, None, 0] - along[:, None, 1] * outline[..., 1]
    rings[..., 1] = outline[..., 0]
    rings[..., 2] = path[:, None, 1] + along[:, None, 0] * outline[..., 1]
    return loft(rings, closed=closed)


def rounded_ends(stations: np.ndarray, share: float) -> np.ndarray:
    """Factor in [0, 1] on the radius at ``stations`` in [0, 1]: an elliptic end on each ``share`` of the length."""
    depth = np.clip(np.minimum(stations, 1 - stations) / share, 0, 1)
    return np.maximum(np.sqrt(1 - (1 - depth) ** 2), 0.02)


def rod(length: float, radii: np.ndarray, share: float = 0.1, sides: int = 16, exponent: float = 2.0) -> Manifold:
    """Upright bar from z = 0 to ``length`` with rounded ends.

    Args:
        length: of the bar.
        radii: half-widths (2,) or (K, 2) along y and x, evenly spaced from the lower to the upper end.
        share: part of the length over which each end is rounded.
        sides: of a section.
        exponent: see ``section``.
    """
    stations = (1 - np.cos(np.linspace(0, np.pi, 25))) / 2
    knots = np.atleast_2d(np.asarray(radii, dtype=float))
    knots = np.repeat(knots, 2, axis=0) if len(knots) == 1 else knots
    widths = PchipInterpolator(np.linspace(0, 1, len(knots)), knots)(stations)
    path = np.stack([0 * stations, stations * length], -1)
    return tube(path, widths * rounded_ends(stations, share)[:, None], sides, exponent)


def strip(
    stations: np.ndarray, centre: np.ndarray, widths: np.ndarray, thickness: np.ndarray, dish: np.ndarray | float = 0.0
) -> Manifold:
    """Thin bar along x, flat or dished like a spoon.

    Args:
        stations: x of each section (K,), rising.
        centre: y and z of each section's middle (K, 2).
        widths: half-widths along y (K,).
        thickness: half-heights along z (K,).
        dish: how much lower than its edges the middle of each section lies, () or (K,).
    """
    outline = section(24, 3.0)
    rings = np.empty((len(stations), len(outline), 3))
    rings[..., 0] = stations[:, None]
    rings[..., 1] = centre[:, :1] + widths[:, None] * outline[:, 0]
    rings[..., 2] = centre[:, 1:] + thickness[:, None] * outline[:, 1]
    rings[..., 2] += np.broadcast_to(dish, stations.shape)[:, None] * (outline[:, 0] ** 2 - 1)
    return loft(rings)


def revolve(profile: np.ndarray, sides: int = _SIDES) -> Manifold:
    """Surface of revolution about z of the polygon ``profile`` (K, 2): radius and height."""
    return CrossSection([profile], FillRule.NonZero).revolve(sides)


def cylinder(radius: float, height: float, sides: int = _SIDES, upper: float | None = None) -> Manifold:
    """Upright cylinder, or cone up to the radius ``upper``, standing on z = 0."""
    return Manifold.cylinder(height, radius, radius if upper is None else upper, sides)


def capsule(length: float, radius: float, sides: int = 24) -> Manifold:
    """Upright capsule of total ``length`` about the origin."""
    half = max(length / 2 - radius, 0.0)
    ball = Manifold.sphere(radius, sides)
    return Manifold.batch_hull([ball.translate([0, 0, half]), ball.translate([0, 0, -half])])


def smooth_curve(knots: np.ndarray, count: int) -> np.ndarray:
    """Smooth curve (count, D) through ``knots`` (K, D) that overshoots none of them."""
    steps = np.linalg.norm(np.diff(knots, axis=0), axis=1)
    at = np.r_[0, np.cumsum(np.maximum(steps, 1e-6))]
    return PchipInterpolator(at, knots)(np.linspace(0, at[-1], count))


def shell(outer: np.ndarray, wall: float) -> tuple[Manifold, Manifold]:
    """A vessel open at the top, as the solid it is cut from and the cavity to be cut.

    Args:
        outer: its outside (K, 2), radius and height, from the axis at the bottom up to the rim.
        wall: thickness.
    """
    rim = outer[-1]
    body = np.concatenate([outer, [[0, rim[1]]]])
    tall = np.concatenate([outer, rim + [[0, 2 * wall]]])
    mirrored = np.concatenate([tall, tall[::-1] * [-1, 1]])
    inside = CrossSection([mirrored], FillRule.NonZero).offset(-wall, circular_segments=16)
    return revolve(body), inside.revolve(_SIDES)


def regular(sides: int, phase: float = 0.0) -> np.ndarray:
    """Regular polygon (sides, 2) on the unit circle, its first corner at ``phase`` radians."""
    angle = phase + 2 * np.pi * np.arange(sides) / sides
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def soften(polygon: np.ndarray, radius: float) -> np.ndarray:
    """``polygon`` (K, 2) with all corners rounded, of what is left the largest part."""
    area = CrossSection([polygon], FillRule.NonZero)
    for step in (-radius, 2 * radius, -radius):
        area = area.offset(step, circular_segments=16)
    parts = area.simplify(radius * 0.02).decompose()
    if not parts:
        raise PwmGymError(f"a polygon thinner than {2 * radius:.3g} has no room for corners of radius {radius:.3g}")
    return max(parts, key=lambda part: part.area()).to_polygons()[0]


def prism(polygon: np.ndarray, height: float, bevel: float = 0.0, taper: float = 1.0) -> Manifold:
    """Extrusion along z from 0 to ``height``.

    Args:
        polygon: its base (K, 2), counter-clockwise; with a bevel its corners are to be rounder than that.
        height: along z.
        bevel: radius of the rounded upper and lower edges.
        taper: size of the top against the base.
    """
    quarter = np.linspace(0, np.pi / 2, 4) if bevel > 0 else np.zeros(1)
    inset = bevel * np.r_[1 - np.sin(quarter), 1 - np.sin(quarter[::-1])] if bevel > 0 else np.zeros(2)
    level = np.r_[bevel * (1 - np.cos(quarter)), height - bevel * (1 - np.cos(quarter[::-1]))]
    scale = 1 + (taper - 1) * level / height
    rings = np.empty((len(level), len(polygon), 3))
    rings[..., :2] = (polygon - inset[:, None, None] * _mitres(polygon)) * scale[:, None, None]
    rings[..., 2] = level[:, None]
    return loft(rings, cap=triangulate([np.ascontiguousarray(polygon)]))


def rounded_box(size: ArrayLike, radius: float, taper: ArrayLike = (1.0, 1.0)) -> Manifold:
    """Box about the origin with rounded edges.

    Args:
        size: edges (3,).
        radius: of the rounding, below half the shortest edge.
        taper: size of the top against the bottom, along x and y.
    """
    edges = np.asarray(size, dtype=float)
    half = np.maximum(edges / 2 - radius, 1e-4)
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * half
    corners[corners[:, 2] > 0, :2] *= taper
    if radius <= 0:
        return Manifold.hull_points(corners)
    ball = Manifold.sphere(radius, 28 if radius > 0.15 * edges.min() else 16)
    return Manifold.batch_hull([ball.translate(list(corner)) for corner in corners])


def superquadric(radii: ArrayLike, roundness: tuple[float, float] = (1.0, 1.0), sides: int = 48) -> Manifold:
    """Superquadric about the origin.

    Args:
        radii: half-extents (3,).
        roundness: exponents from pole to pole and around z: 1 is an ellipsoid, near 0 a box, near 2 an octahedron.
        sides: of the sphere it is made of.
    """
    extents, (polar, around) = np.asarray(radii, dtype=float), roundness

    def inflate(points: np.ndarray) -> np.ndarray:
        x, y, z = np.abs(points.T)
        flat = (x ** (2 / around) + y ** (2 / around)) ** (around / polar)
        return points / (flat + z ** (2 / polar))[:, None] ** (polar / 2) * extents

    return Manifold.sphere(1.0, sides).warp_batch(inflate)


def warp(solid: Manifold, move: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Manifold:
    """``solid`` with its vertices moved by ``move(points, share)``; ``share`` is 0 at its lowest, 1 at its highest."""
    low, high = solid.bounding_box()[2], top(solid)
    return solid.warp_batch(lambda points: move(points, (points[:, 2] - low) / (high - low)))


def bend(solid: Manifold, angle: float) -> Manifold:
    """Bends the upright axis of ``solid`` into an arc of ``angle`` radians in the plane of x and z."""
    if abs(angle) < 1e-3:
        return solid
    radius = (top(solid) - solid.bounding_box()[2]) / angle

    def curl(points: np.ndarray, share: np.ndarray) -> np.ndarray:
        reach, turn = radius - points[:, 0], (share - 0.5) * angle
        return np.stack([radius - reach * np.cos(turn), points[:, 1], reach * np.sin(turn)], -1)

    return warp(solid, curl)


def twist(solid: Manifold, angle: float) -> Manifold:
    """Turns the top of ``solid`` against its bottom by ``angle`` radians about z."""

    def turn(points: np.ndarray, share: np.ndarray) -> np.ndarray:
        c, s = np.cos(share * angle), np.sin(share * angle)
        x, y, z = points.T
        return np.stack([c * x - s * y, s * x + c * y, z], -1)

    return warp(solid, turn)


def shear_taper(solid: Manifold, shear: float, taper: float) -> Manifold:
    """Shifts the top of ``solid`` along x by ``shear`` and scales it there by ``taper``, both rising with z."""

    def move(points: np.ndarray, share: np.ndarray) -> np.ndarray:
        moved = points * np.stack([1 + (taper - 1) * share] * 2 + [np.ones_like(share)], -1)
        return moved + np.outer(shear * share, [1, 0, 0])

    return warp(solid, move)


def level_set(field: Callable[[np.ndarray], np.ndarray], half: float, cells: int = 26) -> Manifold:
    """Surface where ``field`` is 0 in the cube from -``half`` to ``half``, by surface nets.

    Gibson, "Constrained Elastic Surface Nets", 1998: smoothed, and moved onto the surface by Newton steps.

    Args:
        field: of points (M, 3), about their signed distances (M,), below 0 inside. What leaves the cube is cut off.
        half: of the cube's edge.
        cells: along the longest side of what is inside.
    """
    coarse = half / 8
    grid = _grid(np.full(3, -half), np.full(3, half), coarse)
    near = grid[field(grid.reshape(-1, 3)).reshape(grid.shape[:3]) < coarse]
    if not len(near):
        return Manifold()
    low, high = near.min(0), near.max(0)
    step = float((high - low).max() / cells)
    grid = _grid(low, high, step)
    inside = field(grid.reshape(-1, 3)).reshape(grid.shape[:3]) < 0
    cell, faces = _net(np.pad(inside[1:-1, 1:-1, 1:-1], 1))
    points = grid[0, 0, 0] + (cell + 0.5) * step
    for _ in range(2):
        points = _settle(field, _smoothed(points, faces), step)
    return _solid(points, faces)


def _solid(vertices: np.ndarray, faces: np.ndarray) -> Manifold:
    return Manifold(Mesh64(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.uint64)))


def _grid(low: np.ndarray, high: np.ndarray, step: float) -> np.ndarray:
    """Points (X, Y, Z, 3) every ``step`` from ``low`` to ``high`` and a little beyond."""
    axes = [np.arange(a - step, b + 2 * step, step) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def _smoothed(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Each point moved to the mean of its neighbours."""
    here, there = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    sums = np.stack([np.bincount(here, points[there, axis], len(points)) for axis in range(3)], -1)
    return sums / np.bincount(here, minlength=len(points))[:, None]


def _mitres(polygon: np.ndarray) -> np.ndarray:
    """Shift (K, 2) of each corner by which all edges move outwards by 1."""
    edges = np.roll(polygon, -1, 0) - polygon
    normals = np.stack([edges[:, 1], -edges[:, 0]], -1) / np.linalg.norm(edges, axis=1, keepdims=True)
    both = normals + np.roll(normals, 1, 0)
    return 2 * both / np.maximum((both**2).sum(1, keepdims=True), 0.5)


def _net(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cells (V, 3) that the surface crosses, and triangles (F, 3) that join them."""
    size = np.array(inside.shape) - 1
    ends = itertools.product((0, 1), repeat=3)
    corners = np.stack([inside[i : i + size[0], j : j + size[1], k : k + size[2]] for i, j, k in ends])
    crossed = corners.any(0) & ~corners.all(0)
    index = np.where(crossed, crossed.cumsum().reshape(crossed.shape) - 1, -1)
    faces = []
    for axis in range(3):
        b, c = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
        here = np.moveaxis(inside, axis, 0)
        change = np.moveaxis(here[1:] != here[:-1], 0, axis)
        edge = np.argwhere(change)
        quad = np.stack([index[tuple((edge - shift).T)] for shift in (0 * b, b, b + c, c)], -1)
        leaves = inside[tuple(edge.T)]
        quad = np.where(leaves[:, None], quad, quad[:, ::-1])
        faces += [quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]
    return np.argwhere(crossed), np.concatenate(faces)


def _settle(field: Callable[[np.ndarray], np.ndarray], points: np.ndarray, step: float) -> np.ndarray:
    """``points`` (V, 3) moved onto the surface where ``field`` is 0, by no more than ``step`` along each axis."""
    start, small = points, 1e-3 * step
    for _ in range(2):
        value = field(points)
        slope = np.stack([field(points + small * axis) - value for axis in np.eye(3)], -1) / small
        move = value / np.maximum((slope**2).sum(-1), 1e-3)
        points = np.clip(points - move[:, None] * slope, start - step, start + step)
    return points
