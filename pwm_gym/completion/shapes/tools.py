"""Random hand tools, cutlery and gadgets, put together from rods, strips and boxes."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pwm_gym.completion.draws import chance, log_uniform
from pwm_gym.completion.shapes.primitives import (
    bend,
    capsule,
    cylinder,
    prism,
    regular,
    rod,
    rounded_box,
    rounded_ends,
    section,
    shear_taper,
    smooth_curve,
    soften,
    strip,
    top,
    tube,
    union,
)

__all__ = ["cutlery", "gadget", "tool"]


def tool(rng: np.random.Generator) -> Manifold:
    """A hammer, screwdriver, wrench, brush, marker or pair of scissors."""
    makers = (_hammer, _hammer, _screwdriver, _screwdriver, _wrench, _brush, _marker, _marker, _scissors)
    return makers[rng.integers(len(makers))](rng)


def cutlery(rng: np.random.Generator) -> Manifold:
    """A spoon, ladle, fork, knife or spatula, its length along x."""
    makers = (_spoon, _spoon, _fork, _knife, _spatula)
    return makers[rng.integers(len(makers))](rng)


def gadget(rng: np.random.Generator) -> Manifold:
    """A padlock, drill, spray bottle, torch, clamp or box with buttons or a lens."""
    makers = (_padlock, _padlock, _drill, _spray, _spray, _torch, _clamp, _console)
    return makers[rng.integers(len(makers))](rng)


def _handle(rng: np.random.Generator, length: float, radius: float) -> Manifold:
    """Upright grip from z = 0 to ``length``: waisted, swelling, round, oval or with facets."""
    swell = rng.uniform(0.7, 1.15, (int(rng.integers(2, 6)), 1))
    oval = np.array([1.0, rng.uniform(0.5, 1.0) if chance(rng, 0.5) else 1.0])
    sides = int(rng.integers(5, 9)) if chance(rng, 0.25) else 16
    return rod(length, radius * swell * oval, rng.uniform(0.03, 0.15), sides, rng.uniform(2, 4))


def _hammer(rng: np.random.Generator) -> Manifold:
    """A handle with a head across it: claw hammer, sledge or mallet."""
    width, reach = rng.uniform(0.05, 0.11), rng.uniform(0.15, 0.3)
    handle = rod(1.0, rng.uniform(0.025, 0.06, (4, 2)), 0.03, exponent=rng.uniform(2, 4))
    face = cylinder(width, reach, 24, width * rng.uniform(0.7, 1.1)).rotate([0, -90, 0])
    if chance(rng, 0.4):
        block = rounded_box([2 * reach, 2 * width, 2 * width], rng.uniform(0.1, 0.6) * width)
        return handle + block.translate([0, 0, 1 - width / 2])
    middle = rounded_box([2.4 * width, 1.6 * width, 1.8 * width], 0.3 * width)
    tail = rounded_box([1.6 * width, 1.6 * width, reach], 0.2 * width, (rng.uniform(0.1, 0.4), 1.2))
    tail = bend(tail.refine_to_length(reach / 6), rng.uniform(0.0, 1.0))
    if chance(rng, 0.5):
        tail -= rounded_box([1.0, 0.5 * width, reach], 0.02, (1.0, 2.0)).translate([0, 0, reach * 0.5])
    tail = tail.rotate([0, 90, 0]).translate([reach / 2 + 0.5 * width, 0, 0])
    return handle + (face + middle + tail).translate([0, 0, 1 - width / 2])


def _screwdriver(rng: np.random.Generator) -> Manifold:
    """A thick handle, perhaps fluted, with a thin shaft and a flat or pointed tip."""
    length, radius = rng.uniform(0.3, 0.65), rng.uniform(0.06, 0.16)
    handle = _handle(rng, length, radius)
    if chance(rng, 0.5):
        groove = capsule(0.6 * length, 0.25 * radius, 12).translate([1.05 * radius, 0, 0.5 * length])
        handle -= union([groove.rotate([0, 0, 60.0 * k]) for k in range(6)])
    thin, reach = rng.uniform(0.015, 0.04), rng.uniform(0.35, 0.75)
    shaft = cylinder(thin, reach, 16).translate([0, 0, length - 0.05])
    if chance(rng, 0.5):
        tip = rounded_box([1.2 * thin, 2.6 * thin, 0.12], 0.0, (0.3, 1.0))
    else:
        tip = cylinder(thin, 0.06, 8, 0.3 * thin)
    return handle + shaft + tip.translate([0, 0, length + reach - 0.06])


def _wrench(rng: np.random.Generator) -> Manifold:
    """A flat bar with a jaw at one end and a ring or a jaw at the other."""
    thick, half = rng.uniform(0.05, 0.12), rng.uniform(0.045, 0.09)
    bar = rounded_box([1.0, 2 * half, thick], 0.3 * thick)
    for side in (-1, 1):
        radius = half * rng.uniform(1.6, 2.6)
        head = prism(regular(32) * radius, 1.3 * thick, 0.3 * thick).translate([0, 0, -0.65 * thick])
        if side > 0 or chance(rng, 0.4):
            cut = rounded_box([2 * radius, 1.1 * radius, 1.0], 0.02).translate([0.7 * radius, 0, 0])
            cut = cut.rotate([0, 0, 15.0 * rng.integers(-1, 2) + (180 if side < 0 else 0)])
        else:
            cut = cylinder(0.6 * radius, 1.0, 6 if chance(rng, 0.5) else 24).translate([0, 0, -0.5])
        place = [0.5 * side, 0, 0]
        bar = bar + head.translate(place) - cut.translate(place)
    return bar


def _brush(rng: np.random.Generator) -> Manifold:
    """A handle that widens into a head with a block of bristles: paint, tooth or scrubbing brush."""
    width, length = log_uniform(rng, 0.04, 0.25), log_uniform(rng, 0.1, 0.5)
    handle = _handle(rng, 0.75, rng.uniform(0.03, 0.06))
    thick = min(width, rng.uniform(0.04, 0.1))
    head = rounded_box([thick, 2 * width, length], 0.45 * thick, (1.0, rng.uniform(0.7, 1.1)))
    bristles = rounded_box([rng.uniform(0.1, 0.25), 1.7 * width, 0.85 * length], 0.02, (rng.uniform(0.8, 1.3), 1.0))
    if chance(rng, 0.5):
        bristles = bristles.translate([0.12, 0, 0])
    else:
        bristles = rounded_box([0.9 * thick, 1.9 * width, length], 0.01, (0.6, 1.2)).translate([0, 0, 0.8 * length])
    return handle + (head + bristles).translate([0, 0, 0.73 + length / 2])


def _marker(rng: np.random.Generator) -> Manifold:
    """A pen or marker: a barrel with a cap and perhaps a clip, or a bare tip."""
    radius, split = rng.uniform(0.03, 0.12), rng.uniform(0.55, 0.8)
    sides = 6 if chance(rng, 0.2) else 24
    barrel = cylinder(radius, split, sides, radius * rng.uniform(0.9, 1.15))
    wide = radius * rng.uniform(0.95, 1.25)
    if chance(rng, 0.3):
        tip = cylinder(radius * rng.uniform(0.5, 0.9), rng.uniform(0.05, 0.3), sides, 0.15 * radius)
        return barrel + tip.translate([0, 0, 0.999 * split])
    cap = rod(1 - split + 0.1, np.array([wide, wide]), rng.uniform(0.05, 0.25), 24).translate([0, 0, split - 0.1])
    if chance(rng, 0.4):
        length = 0.8 * (1 - split)
        cap += rounded_box([0.8 * radius, 0.5 * radius, length], 0.1 * radius).translate([wide, 0, 1 - length / 2])
    return barrel + cap


def _scissors(rng: np.random.Generator) -> Manifold:
    """Two crossing arms with a ring, or a straight grip, at the end of each: scissors or pliers."""
    opening, thick = rng.uniform(4, 25), rng.uniform(0.03, 0.08)
    width, ring, jaw = rng.uniform(0.03, 0.06), rng.uniform(0.08, 0.14), rng.uniform(0.25, 0.6)
    blade = rounded_box([2 * width, thick, jaw], 0.01, (rng.uniform(0.1, 0.6), 1.0)).translate([0, 0, jaw / 2])
    grip = rounded_box([1.5 * width, thick, 0.35], 0.01).translate([0, 0, -0.16])
    if chance(rng, 0.6):
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        path = np.stack([ring * np.cos(angle), 1.3 * ring * np.sin(angle)], -1)
        grip += tube(path, np.array([0.5 * thick, 0.025]), 8, closed=True).translate([0.3 * ring, 0, -0.3 - 1.3 * ring])
    else:
        grip += _handle(rng, 0.5, width).translate([0, 0, -0.8])
    arm = (blade + grip).rotate([0, opening / 2, 0]).translate([0, -0.4 * thick, 0])
    pin = cylinder(1.4 * width, 1.8 * thick, 20).translate([0, 0, -0.9 * thick]).rotate([90, 0, 0])
    return arm + arm.mirror([1, 0, 0]).translate([0, 0.8 * thick, 0]) + pin


def _stem(rng: np.random.Generator, thick: float) -> tuple[np.ndarray, np.ndarray]:
    """Half-widths (16,) of a handle of cutlery along its length, and its height (16,): a shallow arc."""
    knots = np.stack([np.linspace(0, 1, 4), rng.uniform([0.03, 0.025, 0.015, 0.015], [0.07, 0.06, 0.03, 0.03])], -1)
    widths = np.maximum(smooth_curve(knots, 16)[:, 1], 1.2 * thick)
    return widths, rng.uniform(-0.05, 0.08) * np.sin(np.linspace(0, np.pi, 16))


def _join(
    rng: np.random.Generator, length: float, head: np.ndarray, drop: np.ndarray, dish: np.ndarray | float
) -> Manifold:
    """A handle of length 1 along x, followed by a head: half-widths, heights and dish (K,) along ``length``."""
    thick = rng.uniform(0.012, 0.03)
    widths, rise = _stem(rng, thick)
    along = np.linspace(0, 1, 16) ** 1.8
    stations = np.r_[along, 1 + np.linspace(0, length, len(head) + 1)[1:]]
    widths = np.r_[widths * rounded_ends(along / 2, 0.025), head]
    height = np.r_[rise, drop]
    depth = np.r_[np.zeros(16), np.broadcast_to(dish, head.shape)]
    body = np.full_like(stations, thick) * np.r_[np.linspace(1.6, 1, 16), np.full(len(head), 0.7)]
    return strip(stations, np.stack([0 * stations, height], -1), widths, body, depth)


def _spoon(rng: np.random.Generator) -> Manifold:
    """A spoon or ladle with an oval or round dished head."""
    length, width = rng.uniform(0.25, 0.55), rng.uniform(0.09, 0.24)
    share = np.linspace(0, 1, 17)[1:]
    head = 0.015 + width * np.sin(np.pi * share ** rng.uniform(0.7, 1.1)) ** rng.uniform(0.5, 0.7)
    depth = rng.uniform(0.2, 0.6) * np.minimum(length, 2 * width) / 2
    dish = depth * (head / head.max()) ** 2
    drop = -rng.uniform(0.0, 0.5) * depth * np.sin(np.pi * share)
    return _join(rng, length, head, drop, dish)


def _fork(rng: np.random.Generator) -> Manifold:
    """A fork with two to four tines."""
    length, width, tines = rng.uniform(0.35, 0.55), rng.uniform(0.06, 0.12), int(rng.integers(2, 5))
    share = np.linspace(0, 1, 17)[1:]
    head = 0.02 + (width - 0.02) * np.clip(share / rng.uniform(0.2, 0.5), 0, 1) ** 0.6
    drop = -rng.uniform(0.0, 0.12) * np.sin(np.pi * share ** rng.uniform(0.6, 1.2))
    fork = _join(rng, length, head, drop, rng.uniform(0, 0.02))
    gap = 2 * width / (2 * tines - 1)
    reach = length * rng.uniform(0.5, 0.7)
    slot = rounded_box([2 * reach, gap, 1.0], 0.3 * gap).translate([1 + length, 0, 0])
    return fork - union([slot.translate([0, (2 * k - tines + 2) * gap, 0]) for k in range(tines - 1)])


def _knife(rng: np.random.Generator) -> Manifold:
    """A grip with a flat blade that narrows to its tip: table knife, chef's knife or peeler."""
    length, width, grip = rng.uniform(0.5, 1.5), rng.uniform(0.04, 0.16), rng.uniform(0.03, 0.05)
    share = np.linspace(0, 1, 14)
    half = width * np.maximum(1 - share ** rng.uniform(1.5, 6), 0.04)
    centre = np.stack([rng.uniform(-1, 1) * (width - half), 0 * share], -1)
    thick = rng.uniform(0.008, 0.02) * np.linspace(1, 0.5, 14)
    blade = strip(share * length, centre, half, thick)
    handle = rod(rng.uniform(0.5, 0.9), rng.uniform(0.6, 1.0, (4, 2)) * [1.6 * grip, grip], 0.08, exponent=3)
    return blade.translate([-0.03, 0, 0]) + handle.rotate([0, -90, 0])


def _spatula(rng: np.random.Generator) -> Manifold:
    """A turner: a broad thin head, angled to the handle, often with slots."""
    length, width, bent = rng.uniform(0.3, 0.6), rng.uniform(0.12, 0.28), rng.uniform(0.0, 0.25)
    share = np.linspace(0, 1, 11)[1:]
    head = width * np.clip(share / 0.25, 0.15, 1) ** 0.7 * (1 + rng.uniform(-0.2, 0.3) * share)
    drop = -bent * np.minimum(share * 3, 1) * length
    turner = _join(rng, length, head, drop, 0.0)
    if chance(rng, 0.3):
        return turner
    count, gap = int(rng.integers(2, 6)), 2 * width / 13
    slot = rounded_box([0.5 * length, gap, 2.0], 0.3 * gap).translate([1 + 0.6 * length, 0, 0])
    turner -= union([slot.translate([0, (2 * k - count + 1) * gap, 0]) for k in range(count)])
    return turner


def _padlock(rng: np.random.Generator) -> Manifold:
    """A block or disc with a shackle, shut or open."""
    wide, thick, rod_radius = rng.uniform(0.35, 0.6), rng.uniform(0.15, 0.4), rng.uniform(0.04, 0.08)
    if chance(rng, 0.25):
        body = cylinder(wide, thick, 40).translate([0, 0, -thick / 2]).rotate([90, 0, 0])
    else:
        body = rounded_box([2 * wide, thick, rng.uniform(0.7, 1.1)], rng.uniform(0.05, 0.45) * thick)
    arch, leg = wide * rng.uniform(0.5, 0.75), rng.uniform(0.1, 0.8)
    angle = np.linspace(0, np.pi, 16)
    bow = np.stack([arch * np.cos(angle), leg + arch * np.sin(angle)], -1)
    foot = leg + rod_radius if chance(rng, 0.25) else -0.4
    path = np.concatenate([[[arch, -0.4]], bow, [[-arch, foot - 0.05]]])
    shackle = tube(path, np.array([rod_radius, rod_radius]), 12)
    return body + shackle.translate([0, 0, top(body) - 0.1])


def _drill(rng: np.random.Generator) -> Manifold:
    """A power drill or glue gun: a barrel across a grip, a chuck in front, a trigger and a base."""
    length, radius = rng.uniform(0.55, 0.9), rng.uniform(0.12, 0.2)
    barrel = rod(length, radius * rng.uniform(0.8, 1.1, (4, 2)), 0.1, exponent=rng.uniform(2, 4))
    chuck = cylinder(0.75 * radius, 0.2, 24, 0.4 * radius).translate([0, 0, 0.98 * length])
    bit = cylinder(0.2 * radius, rng.uniform(0.25, 0.5), 12).translate([0, 0, length])
    front = barrel + chuck + (bit if chance(rng, 0.6) else chuck)
    height = rng.uniform(0.5, 0.7)
    grip = rounded_box([0.2, 0.16, height], 0.06, (1.15, 1.0)).translate([0, 0, -height / 2])
    foot = rounded_box([rng.uniform(0.25, 0.45), 0.24, rng.uniform(0.12, 0.22)], 0.03).translate([0.05, 0, -height])
    lower = shear_taper(grip + foot, rng.uniform(0.0, 0.2), 1.0)
    trigger = rounded_box([0.12, 0.08, 0.14], 0.03).translate([0.16, 0, -radius - 0.08])
    return front.rotate([0, 90, 0]).translate([-rng.uniform(0.2, 0.5) * length, 0, 0]) + lower + trigger


def _spray(rng: np.random.Generator) -> Manifold:
    """A spray bottle or pump dispenser: a body, a neck, and a head with a nozzle and perhaps a trigger."""
    height, wide, deep = rng.uniform(0.8, 1.8), rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.5)
    body = prism(section(40, rng.uniform(2, 6)) * [wide, deep], height, rng.uniform(0.03, 0.12), rng.uniform(0.5, 1.0))
    neck = cylinder(0.12, 0.45, 20, rng.uniform(0.08, 0.12)).translate([0, 0, height - 0.15])
    place = [0, 0, height + 0.3]
    if chance(rng, 0.4):
        spout = rod(0.5, np.array([[0.09, 0.09], [0.06, 0.05]]), 0.1).rotate([0, 90 + rng.uniform(0, 20), 0])
        return body + neck + spout.translate([-0.1, 0, height + 0.3])
    block = rounded_box([rng.uniform(0.4, 0.7), 0.2, 0.2], 0.06, (0.85, 0.8)).translate([0.08, 0, 0])
    nozzle = cylinder(0.07, 0.15, 12).rotate([0, 90, 0]).translate([0.3, 0, 0.02])
    path = smooth_curve(np.array([[0.2, 0.0], [0.28, -0.15], [0.24, -rng.uniform(0.3, 0.45)]]), 8)
    trigger = tube(path, np.array([0.06, 0.03]), 8)
    return body + neck + (block + nozzle + trigger).translate(place)


def _torch(rng: np.random.Generator) -> Manifold:
    """A torch or shaker: a grip with a wider head at one end, and perhaps a switch."""
    radius, head = rng.uniform(0.08, 0.15), rng.uniform(0.13, 0.26)
    length, flare = rng.uniform(0.5, 0.8), rng.uniform(0.05, 0.25)
    torch = cylinder(radius, length, 32) + cylinder(radius, flare, 32, head).translate([0, 0, 0.999 * length])
    torch += cylinder(head, rng.uniform(0.08, 0.2), 32).translate([0, 0, 0.998 * (length + flare)])
    if chance(rng, 0.5):
        torch += rounded_box([0.06, 0.08, 0.16], 0.02).translate([radius, 0, 0.7 * length])
    if chance(rng, 0.5):
        torch -= cylinder(0.85 * head, 0.3, 32).translate([0, 0, top(torch) - 0.04])
    return torch


def _clamp(rng: np.random.Generator) -> Manifold:
    """A C-shaped frame with a screw through its open side."""
    outline = np.array([[0, 0], [1, 0], [1, 0.25], [0.3, 0.25], [0.3, 0.9], [1, 0.9], [1, 1.1], [0, 1.1]])
    outline = (outline - 0.5) * [rng.uniform(0.6, 1.1), 1.0]
    frame = prism(soften(outline, 0.05), rng.uniform(0.12, 0.3)).rotate([90, 0, 0])
    box = frame.bounding_box()
    frame = frame.translate([0, -(box[1] + box[4]) / 2, 0])
    at = box[3] - 0.12
    screw = cylinder(0.045, rng.uniform(0.6, 1.1), 12).translate([at, 0, box[2] - 0.5])
    pad = cylinder(0.09, 0.06, 20).translate([at, 0, top(screw) - 0.03])
    bar = capsule(rng.uniform(0.25, 0.5), 0.03, 12).rotate([90, 0, 0]).translate([at, 0, box[2] - 0.45])
    return frame + screw + pad + bar


def _console(rng: np.random.Generator) -> Manifold:
    """A flat box with buttons, or a deeper one with a lens: remote control, phone, camera."""
    size = [rng.uniform(0.3, 1.0), 1.0, log_uniform(rng, 0.08, 0.5)]
    box = rounded_box(size, rng.uniform(0.1, 0.45) * min(size))
    upper = size[2] / 2
    if chance(rng, 0.4):
        reach, radius = rng.uniform(0.1, 0.4), rng.uniform(0.2, 0.45) * size[0]
        lens = cylinder(radius, reach, 32) - cylinder(0.8 * radius, reach, 32).translate([0, 0, 0.6 * reach])
        return box + lens.translate([0, rng.uniform(-0.15, 0.15), 0.98 * upper])
    columns, rows = rng.integers(1, 4), rng.integers(2, 5)
    pitch = 0.7 * np.array([size[0] / columns, 1.0 / rows])
    button = rounded_box([0.6 * pitch[0], 0.6 * pitch[1], 0.08 + 0.2 * upper], 0.02)
    where = [(c - (columns - 1) / 2, r - (rows - 1) / 2) for c in range(columns) for r in range(rows)]
    return box + union([button.translate([c * pitch[0], r * pitch[1], 0.95 * upper]) for c, r in where])
