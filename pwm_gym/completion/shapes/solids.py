"""Random boxes, extrusions, toys, rings and chains, and booleans and blends of simple solids."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from manifold3d import Manifold

from pwm_gym.completion.draws import chance, log_uniform, turn_angles
from pwm_gym.completion.shapes.primitives import (
    capsule,
    cylinder,
    level_set,
    prism,
    regular,
    rod,
    rounded_box,
    shear_taper,
    soften,
    superquadric,
    tube,
    twist,
    union,
)

__all__ = ["blend", "boolean", "box", "extrusion", "ring", "toy"]

_Field = Callable[[np.ndarray], np.ndarray]


def box(rng: np.random.Generator) -> Manifold:
    """A brick, stick, plate or die: edges sharp or rounded, sides straight, tapered or leaning."""
    if chance(rng, 0.2):
        size = rng.uniform(0.9, 1.0, 3)
    else:
        size = np.array([log_uniform(rng, 0.06, 1.0) for _ in range(3)])
    radius = rng.uniform(0, 0.48) ** 1.5 * size.min() if chance(rng, 0.8) else 0.0
    taper = rng.uniform(0.3, 1.0, 2) if chance(rng, 0.25) else rng.uniform(0.95, 1.0, 2)
    solid = rounded_box(size, radius, taper)
    if chance(rng, 0.1):
        solid = shear_taper(solid, rng.uniform(-0.7, 0.7) * size[2], 1.0)
    return _dented(rng, solid, size) if chance(rng, 0.15) else solid


def extrusion(rng: np.random.Generator) -> Manifold:
    """A random outline, extruded: plain, bevelled, tapered, pierced or twisted."""
    outline = _OUTLINES[rng.integers(len(_OUTLINES))](rng)
    corner = rng.uniform(0.02, 0.08)
    height = log_uniform(rng, 0.1, 3.0)
    bevel = min(0.8 * corner, 0.4 * height) if chance(rng, 0.5) else 0.0
    outline = soften(outline, corner) if bevel or chance(rng, 0.5) else outline
    taper = rng.uniform(0.4, 1.2) if chance(rng, 0.25) else 1.0
    solid = prism(outline, height, bevel, taper)
    if chance(rng, 0.2):
        solid -= cylinder(rng.uniform(0.1, 0.3), 2 * height).translate([*rng.uniform(-0.2, 0.2, 2), -height / 2])
    if chance(rng, 0.15):
        solid = twist(solid.refine_to_length(max(0.15, height / 8)), rng.uniform(-1.5, 1.5))
    return solid


def toy(rng: np.random.Generator) -> Manifold:
    """A brick with studs, a pile of blocks, a stack of rings, a car or a dumb-bell."""
    makers = (_studded, _studded, _studded, _pile, _ring_stack, _car, _dumbbell)
    return makers[rng.integers(len(makers))](rng)


def ring(rng: np.random.Generator) -> Manifold:
    """A ring, washer or nut, or a chain of links that hang in each other."""
    kind = rng.choice(["ring", "nut", "chain"])
    if kind == "chain":
        return _chain(rng)
    if kind == "nut":
        height = rng.uniform(0.1, 0.9)
        outline = regular(int(rng.integers(4, 9))) if chance(rng, 0.5) else regular(48)
        return prism(outline, height, 0.05, rng.uniform(0.7, 1)) - cylinder(rng.uniform(0.2, 0.6), height)
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    path = np.stack([np.cos(angle), rng.uniform(0.7, 1.0) * np.sin(angle)], -1)
    radii = np.array([log_uniform(rng, 0.08, 0.5), rng.uniform(0.05, 0.35)])
    return tube(path, radii, 16, rng.uniform(1.5, 5), closed=True)


def boolean(rng: np.random.Generator) -> Manifold:
    """Two to four simple solids, joined, cut or intersected; the largest piece of the result."""
    solid = _simple(rng)
    for _ in range(int(rng.integers(1, 4))):
        other = _simple(rng).rotate(turn_angles(rng)).translate(list(rng.uniform(-0.5, 0.5, 3)))
        act = rng.choice(["join", "cut", "cut", "meet"], p=[0.4, 0.25, 0.25, 0.1])
        joined = {"join": solid + other, "cut": solid - other, "meet": solid ^ other}[act]
        solid = joined if joined.volume() > 0.15 * solid.volume() else solid
    return max(solid.decompose(), key=lambda part: part.volume())


def blend(rng: np.random.Generator) -> Manifold:
    """A smooth union of two to five balls, capsules, boxes and rings, perhaps with a smooth dent."""
    count, softness = int(rng.integers(2, 6)), rng.uniform(0.03, 0.25)
    fields = [_field(rng) for _ in range(count)]
    hollow = _ball_field(rng.uniform(-0.6, 0.6, 3), rng.uniform(0.15, 0.4)) if chance(rng, 0.3) else None

    def field(points: np.ndarray) -> np.ndarray:
        value = fields[0](points)
        for other in fields[1:]:
            value = _smooth_min(value, other(points), softness)
        return value if hollow is None else -_smooth_min(-value, hollow(points), 0.05)

    stretch = rng.uniform(0.5, 1.0, 3)
    return max(level_set(field, 1.4).decompose(), key=lambda part: part.volume()).scale(list(stretch))


def _dented(rng: np.random.Generator, solid: Manifold, size: np.ndarray) -> Manifold:
    """Cuts a groove or a pit into the top."""
    cut = rng.uniform(0.2, 0.7, 3) * size
    if chance(rng, 0.5):
        cut[0] = 2 * size[0]
    return solid - rounded_box(cut, 0.2 * cut.min()).translate([0, 0, size[2] / 2])


def _letter(rng: np.random.Generator) -> np.ndarray:
    """An L, T, U, cross, H, Z or stair."""
    a, b = rng.uniform(0.25, 0.45, 2)
    c, d = 1 - rng.uniform(0.25, 0.4, 2)
    letters = {
        "l": [[0, 0], [1, 0], [1, a], [b, a], [b, 1], [0, 1]],
        "t": [[a, 0], [c, 0], [c, d], [1, d], [1, 1], [0, 1], [0, d], [a, d]],
        "u": [[0, 0], [1, 0], [1, 1], [c, 1], [c, a], [b, a], [b, 1], [0, 1]],
        "x": [[a, 0], [c, 0], [c, b], [1, b], [1, d], [c, d], [c, 1], [a, 1], [a, d], [0, d], [0, b], [a, b]],
        "h": [[0, 0], [a, 0], [a, b], [c, b], [c, 0], [1, 0], [1, 1], [c, 1], [c, d], [a, d], [a, 1], [0, 1]],
        "z": [[0, 0], [c, 0], [c, d], [1, d], [1, 1], [a, 1], [a, b], [0, b]],
        "stair": [[0, 0], [1, 0], [1, a], [0.67, a], [0.67, d], [0.33, d], [0.33, 1], [0, 1]],
    }
    points = np.array(letters[rng.choice(list(letters))], dtype=float) - 0.5
    return 2 * points * rng.uniform(0.5, 1.0, 2)


def _star(rng: np.random.Generator) -> np.ndarray:
    """A star or gear with 4 to 12 points."""
    points = int(rng.integers(4, 13))
    outline = regular(2 * points)
    outline[1::2] *= rng.uniform(0.45, 0.85)
    return outline


def _polygon(rng: np.random.Generator) -> np.ndarray:
    """A regular polygon, drawn out, or one with corners at random angles and distances."""
    if chance(rng, 0.4):
        return regular(int(rng.integers(3, 9)), rng.uniform(0, 1)) * [1, rng.uniform(0.4, 1.0)]
    angle = np.sort(rng.dirichlet(np.full(int(rng.integers(4, 10)), 4.0)).cumsum()) * 2 * np.pi
    return rng.uniform(0.45, 1.0, (len(angle), 1)) * np.stack([np.cos(angle), np.sin(angle)], -1)


def _wavy(rng: np.random.Generator) -> np.ndarray:
    """A smooth closed outline: kidney, heart, clover, leaf."""
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    waves = sum(rng.normal(0, 0.35 / k) * np.cos(k * angle + rng.uniform(0, 6.3)) for k in range(2, 6))
    radius = np.clip(1 + waves, 0.35, None)
    return (radius * np.stack([np.cos(angle), np.sin(angle)])).T * [1, rng.uniform(0.4, 1.0)]


def _arc(rng: np.random.Generator) -> np.ndarray:
    """A bent bar: horseshoe, boomerang, slice of a ring."""
    angle = np.linspace(0, rng.uniform(1.5, 5.0), 24)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    return np.concatenate([circle, rng.uniform(0.3, 0.75) * circle[::-1]])


_OUTLINES: tuple[Callable[[np.random.Generator], np.ndarray], ...] = (_letter, _letter, _star, _polygon, _wavy, _arc)


def _studded(rng: np.random.Generator) -> Manifold:
    """A toy brick with studs: plain, sloped or hollow below, and perhaps a smaller one on it."""
    columns, rows = (int(rng.integers(1, high)) for high in (5, 4))
    height = rng.choice([0.4, 0.6, 1.2, 2.0])
    brick = rounded_box([columns, rows, height], rng.uniform(0.01, 0.06)).translate([0, 0, height / 2])
    if chance(rng, 0.4):
        brick -= rounded_box([columns - 0.3, rows - 0.3, height], 0.0).translate([0, 0, 0.5 * height - 0.2])
    if chance(rng, 0.25):
        wedge = rounded_box([1.5 * height, 2 * rows, height], 0.0).rotate([0, rng.uniform(30, 60), 0])
        brick -= wedge.translate([columns / 2 + 0.4 * height, 0, height])
    brick += _studs(rng, columns, rows).translate([0, 0, height])
    if chance(rng, 0.25) and columns > 1:
        upper = rounded_box([1, rows, height], 0.03) + _studs(rng, 1, rows).translate([0, 0, height / 2])
        brick += upper.translate([(1 - columns) / 2, 0, 1.5 * height])
    return brick


def _studs(rng: np.random.Generator, columns: int, rows: int) -> Manifold:
    stud = cylinder(rng.uniform(0.25, 0.35), rng.uniform(0.15, 0.3) + 0.01, 16).translate([0, 0, -0.01])
    where = [(c - (columns - 1) / 2, r - (rows - 1) / 2) for c in range(columns) for r in range(rows)]
    return union([stud.translate([x, y, 0]) for x, y in where])


def _pile(rng: np.random.Generator) -> Manifold:
    """Two to five blocks, each on the last, a little shifted and turned."""
    blocks: list[Manifold] = []
    level = 0.0
    for _ in range(int(rng.integers(2, 6))):
        size = rng.uniform(0.4, 1.0, 3)
        block = rounded_box(size, 0.05).translate([0, 0, size[2] / 2])
        if chance(rng, 0.35):
            block = cylinder(size[0] / 2, size[2], 32, size[0] / 2 * rng.uniform(0.5, 1.0))
        blocks.append(block.rotate([0, 0, rng.uniform(-45, 45)]).translate([*rng.uniform(-0.15, 0.15, 2), level]))
        level += size[2] - 0.01
    return union(blocks)


def _ring_stack(rng: np.random.Generator) -> Manifold:
    """Rings of falling size around a peg on a foot."""
    count, thick = int(rng.integers(2, 6)), rng.uniform(0.15, 0.25)
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    parts = [cylinder(0.9, 0.1, 32), cylinder(0.15, 2 * thick * count + 0.4, 16)]
    for k, radius in enumerate(np.linspace(0.75, rng.uniform(0.4, 0.7), count)):
        loop = tube(circle * (radius - 0.15), np.array([thick, 0.2]), 10, closed=True).rotate([90, 0, 0])
        parts.append(loop.translate([0, 0, 0.08 + thick * (2 * k + 1) * 0.97]))
    return union(parts)


def _car(rng: np.random.Generator) -> Manifold:
    """A car, truck or tram: a body, a cabin and four or six wheels."""
    size = rng.uniform([0.9, 0.4, 0.15], [1.3, 0.6, 0.4])
    body = rounded_box(size, 0.05, (rng.uniform(0.85, 1.0), 0.95))
    cabin = rounded_box(size * rng.uniform([0.3, 0.7, 0.8], [0.7, 0.9, 1.5]), 0.05, (rng.uniform(0.5, 1.0), 0.85))
    solid = body + cabin.translate([rng.uniform(-0.2, 0.2), 0, 0.8 * size[2]])
    radius, width = rng.uniform(0.1, 0.2), rng.uniform(0.06, 0.15)
    wheel = cylinder(radius, width, 24).translate([0, 0, -width / 2]).rotate([90, 0, 0])
    axles = np.array([-0.35, 0.0, 0.35] if chance(rng, 0.2) else [-0.3, 0.3]) * size[0]
    places = [(float(x), side * size[1] / 2) for x in axles for side in (-1, 1)]
    return solid + union([wheel.translate([x, y, -size[2] / 2]) for x, y in places])


def _dumbbell(rng: np.random.Generator) -> Manifold:
    """Two equal ends on a bar: dumb-bell, bone, spool."""
    radius, reach = rng.uniform(0.15, 0.45), rng.uniform(0.1, 0.5)
    if chance(rng, 0.4):
        end = superquadric([radius, radius, radius], (rng.uniform(0.3, 1.0), 1.0), 32)
    else:
        sides = 6 if chance(rng, 0.3) else 32
        end = cylinder(radius, reach, sides, radius * rng.uniform(0.6, 1.0)).translate([0, 0, -reach / 2])
    bar = rod(1.0, rng.uniform(0.25, 0.7, (3, 1)) * radius * np.ones(2), 0.02, 20).translate([0, 0, -0.5])
    return bar + end.translate([0, 0, 0.5]) + end.translate([0, 0, 0.5]).rotate([180, 0, 0])


def _chain(rng: np.random.Generator) -> Manifold:
    """Three to nine oval links, each turned against the last, laid out along an arc."""
    count, thick, sway = int(rng.integers(3, 10)), rng.uniform(0.08, 0.16), rng.uniform(0, 2 * np.pi * 0.8)
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    path = np.stack([0.55 * np.cos(angle), (1 + thick) * np.sin(angle)], -1)
    link = tube(path, np.array([thick, thick]), 8, closed=True)
    pitch = 2.0 - 2 * thick
    heading = sway * (np.arange(count) / count - 0.5)
    ends = pitch * np.cumsum(np.stack([np.sin(heading), np.cos(heading)], -1), 0)
    links = []
    for k, (turn, end) in enumerate(zip(heading, ends, strict=True)):
        turned = link.rotate([0, 0, 45.0 if k % 2 else -45.0]).rotate([0, float(np.degrees(turn)), 0])
        links.append(turned.translate([float(end[0]), 0, float(end[1])]))
    return union(links)


def _simple(rng: np.random.Generator) -> Manifold:
    """A box, cylinder, cone, ball, capsule or prism about the origin, up to 1.4 long."""
    size = rng.uniform(0.3, 1.4, 3)
    kind = rng.choice(["box", "cylinder", "cone", "ball", "capsule", "prism"])
    if kind == "box":
        return rounded_box(size, rng.uniform(0, 0.3) * size.min())
    if kind == "ball":
        return superquadric(size / 2, (rng.uniform(0.4, 1.2), rng.uniform(0.4, 1.2)), 40)
    if kind == "capsule":
        return capsule(1.4, size[0] / 3, 20)
    if kind == "prism":
        outline = _OUTLINES[rng.integers(len(_OUTLINES))](rng)
        return prism(outline * size[0] / 2, size[2]).translate([0, 0, -size[2] / 2])
    upper = size[1] / 2 if kind == "cone" else size[0] / 2
    return cylinder(size[0] / 2, size[2], 36, upper).translate([0, 0, -size[2] / 2])


def _smooth_min(a: np.ndarray, b: np.ndarray, softness: float) -> np.ndarray:
    """Minimum with a rounded crease (Quilez, "Smooth minimum", 2013, polynomial form)."""
    near = np.maximum(softness - np.abs(a - b), 0) / softness
    return np.minimum(a, b) - near**2 * softness / 4


def _ball_field(centre: np.ndarray, radius: float) -> _Field:
    return lambda points: np.linalg.norm(points - centre, axis=-1) - radius


def _field(rng: np.random.Generator) -> _Field:
    """Distance to a ball, capsule, rounded box or ring within 1 of the origin."""
    centre, axis = rng.uniform(-0.5, 0.5, 3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    radius, reach = rng.uniform(0.14, 0.4), rng.uniform(0.2, 0.5)
    kind = rng.choice(["ball", "capsule", "box", "ring"], p=[0.2, 0.35, 0.3, 0.15])
    if kind == "ball":
        return _ball_field(centre, radius)
    if kind == "capsule":
        return lambda p: (
            np.linalg.norm(p - centre - np.clip((p - centre) @ axis, -reach, reach)[..., None] * axis, axis=-1)
            - 0.7 * radius
        )
    if kind == "box":
        half = rng.uniform(0.1, 0.45, 3)
        return lambda p: _box_distance(p - centre, half, 0.05)
    return lambda p: np.hypot(_beside(p - centre, axis) - reach, (p - centre) @ axis) - 0.5 * radius


def _box_distance(points: np.ndarray, half: np.ndarray, radius: float) -> np.ndarray:
    beyond = np.abs(points) - half
    return np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(-1), 0) - radius


def _beside(points: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Distance from the line through the origin along ``axis``."""
    return np.linalg.norm(np.cross(points, axis), axis=-1)
