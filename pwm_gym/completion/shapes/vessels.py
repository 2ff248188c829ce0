"""Random vessels and turned solids: cans, vases, bottles, bowls, plates, lids, mugs, jugs and pans."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pwm_gym.completion.draws import chance, log_uniform
from pwm_gym.completion.shapes.primitives import (
    bend,
    cylinder,
    prism,
    regular,
    revolve,
    rod,
    rounded_box,
    shell,
    smooth_curve,
    superquadric,
    top,
    tube,
    warp,
)

__all__ = ["bottle", "bowl", "lathe", "mug"]


def lathe(rng: np.random.Generator) -> Manifold:
    """A can or another turned solid; some are faceted, or have an oval or squarish section."""
    if chance(rng, 0.4):
        solid = _can(rng)
    else:
        solid = revolve(_turned(rng), int(rng.integers(3, 13)) if chance(rng, 0.2) else 40)
    if chance(rng, 0.25):
        return _flatten(solid, rng, top(solid), top(solid))
    return solid


def bottle(rng: np.random.Generator) -> Manifold:
    """A bottle, jar or flask with a cap; the body may be flat or squarish and have a hole as a handle."""
    height, neck = log_uniform(rng, 0.9, 4.0), rng.uniform(0.22, 0.75)
    shoulder, collar = rng.uniform(0.1, 0.9), rng.uniform(0.1, 0.5)
    waist = 1 - rng.uniform(0.0, 0.1) * height if chance(rng, 0.4) else 1.0
    knots = [[0, 0.05], [0.85, 0], [1, 0.1], [waist, 0.5 * height], [1, 0.95 * height]]
    knots += [[(1 + neck) / 2, height + rng.uniform(0.4, 0.7) * shoulder], [neck, height + shoulder]]
    end = height + shoulder + collar
    outline = np.concatenate([smooth_curve(np.array(knots), 30), [[neck, end], [0, end]]])
    body = _flatten(revolve(outline, 48), rng, height, height + shoulder)
    if chance(rng, 0.2):
        body -= _grip_hole(rng, height)
    return _ribbed(rng, body, height) + _cap(rng, neck).translate([0, 0, end - 0.8 * collar])


def bowl(rng: np.random.Generator) -> Manifold:
    """A bowl, plate, tray, cup or tumbler, hollow; or a lid with a knob, or a goblet."""
    kind = rng.choice(["bowl", "lid", "goblet"], p=[0.75, 0.15, 0.1])
    if kind != "bowl":
        return _lid(rng) if kind == "lid" else _goblet(rng)
    outer, cavity = _vessel(rng, log_uniform(rng, 0.08, 2.5))
    vessel = outer - cavity
    if chance(rng, 0.3):
        vessel = _flatten(vessel, rng, top(vessel), top(vessel))
    return vessel


def mug(rng: np.random.Generator) -> Manifold:
    """A vessel with one or two handles: a mug, jug with a lip, or pan."""
    kind = rng.choice(["mug", "mug", "jug", "pan"])
    low, high = {"mug": (1.2, 2.8), "jug": (1.8, 4.0), "pan": (0.3, 1.0)}[kind]
    outer, cavity = _vessel(rng, log_uniform(rng, low, high), foot=(0.7, 1.0), wall=(0.05, 0.12))
    height = top(outer)
    if kind == "pan":
        return outer + _pan_handle(rng, height) - cavity
    loop = _loop(rng, height)
    both = outer + loop + loop.rotate([0, 0, 180]) if chance(rng, 0.15) else outer + loop
    return _lip(rng, both - cavity, height) if kind == "jug" else both - cavity


def _can(rng: np.random.Generator) -> Manifold:
    """Cylinder with rims, sunk ends and perhaps beads around it."""
    height, rim, sunk = log_uniform(rng, 0.2, 3.5), rng.uniform(0.03, 0.12), rng.uniform(0.01, 0.1)
    lower, upper = rng.uniform(0.85, 1.0, 2)
    z = np.linspace(0, height, 40)
    depth = rng.uniform(0.005, 0.025) if chance(rng, 0.35) else 0.0
    bead = depth * np.cos(z * rng.uniform(8, 20)) * (np.abs(z / height - 0.5) < rng.uniform(0.1, 0.4))
    side = np.stack([0.97 - depth + bead, z], -1)
    side[[0, 1, -2, -1], 0] = [lower, lower + 0.03, upper + 0.03, upper]
    foot = [[0, sunk * height], [lower - rim, sunk * height], [lower - rim / 2, 0]]
    lid = [[upper - rim / 2, height], [upper - rim, (1 - sunk) * height], [0, (1 - sunk) * height]]
    return revolve(np.concatenate([foot, side, lid]))


def _turned(rng: np.random.Generator) -> np.ndarray:
    """Random profile: a vase, cone, chess piece, baluster or disc; smooth or with edges."""
    count = int(rng.integers(2, 8))
    height = log_uniform(rng, 0.4, 8.0)
    levels = np.cumsum(rng.uniform(0.3, 1.0, count))
    levels = (levels - levels[0]) / (levels[-1] - levels[0]) * height
    radii = rng.uniform(0.2, 1.0, count) if count < 6 else rng.uniform(0.4, 1.0, count)
    knots = np.stack([radii, levels], -1)
    if chance(rng, 0.65):
        knots = smooth_curve(knots, 36)
    ends = [[0.0, knots[0, 1]], [0.0, knots[-1, 1]]]
    if chance(rng, 0.4):
        ends[1][1] += rng.uniform(-0.3, 0.8) * min(knots[-1, 0], height)
    return np.concatenate([ends[:1], knots, ends[1:]])


def _flatten(solid: Manifold, rng: np.random.Generator, full: float, gone: float) -> Manifold:
    """Gives ``solid`` a flat or squarish section up to the height ``full``, fading until ``gone``."""
    depth = rng.uniform(0.4, 0.95) if chance(rng, 0.6) else 1.0
    exponent = rng.uniform(2.5, 7.0) if chance(rng, 0.6) else 2.0

    def move(points: np.ndarray, _share: np.ndarray) -> np.ndarray:
        flat = np.abs(points[:, :2])
        radius = np.maximum(np.linalg.norm(flat, axis=1), 1e-9)
        square = radius / np.maximum((flat**exponent).sum(1) ** (1 / exponent), 1e-9)
        weight = np.clip((gone - points[:, 2]) / (gone - full), 0, 1) if gone > full else 1.0
        grow = 1 + weight * (square - 1)
        return points * np.stack([grow, grow * (1 + weight * (depth - 1)), np.ones_like(grow)], -1)

    return warp(solid, move)


def _grip_hole(rng: np.random.Generator, height: float) -> Manifold:
    """Upright slot through the body along y, near its side and upper end."""
    size = [rng.uniform(0.25, 0.4), 4.0, rng.uniform(0.25, 0.45) * height]
    return rounded_box(size, 0.1).translate([0.62, 0, rng.uniform(0.6, 0.7) * height])


def _ribbed(rng: np.random.Generator, body: Manifold, height: float) -> Manifold:
    """Cuts a few shallow grooves around the body, or none."""
    if chance(rng, 0.7):
        return body
    for level in rng.uniform(0.1, 0.4) * height + 0.16 * np.arange(rng.integers(1, 4)):
        angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
        ring = np.stack([np.cos(angle), np.sin(angle)], -1) * rng.uniform(1.0, 1.02)
        body -= tube(ring, np.array([0.04, 0.05]), 6, closed=True).rotate([90, 0, 0]).translate([0, 0, level])
    return body


def _cap(rng: np.random.Generator, neck: float) -> Manifold:
    """A screw cap, ball stopper or nozzle."""
    radius, height = neck * rng.uniform(1.05, 1.35), rng.uniform(0.2, 0.8)
    kind = rng.choice(["screw", "screw", "ball", "nozzle"])
    if kind == "ball":
        return superquadric([radius, radius, radius], sides=24).translate([0, 0, radius])
    cap = cylinder(radius, height, 12 if chance(rng, 0.2) else 40, radius * rng.uniform(0.8, 1.0))
    if kind == "nozzle":
        tip = cylinder(radius * rng.uniform(0.3, 0.6), height * rng.uniform(0.5, 2.0), 24, radius * 0.2)
        cap += tip.translate([0, 0, 0.98 * height])
    return cap


def _vessel(
    rng: np.random.Generator,
    height: float,
    foot: tuple[float, float] = (0.3, 0.95),
    wall: tuple[float, float] = (0.025, 0.1),
) -> tuple[Manifold, Manifold]:
    """Outside and cavity of an open vessel of rim radius 1 (before a barrel's belly)."""
    base = rng.uniform(*foot)
    kind = rng.choice(["straight", "round", "belly", "plate"], p=[0.35, 0.35, 0.2, 0.1])
    share = np.linspace(0, 1, 16)
    rise = {
        "straight": share,
        "round": 1 - np.sqrt(1 - share**2) ** rng.uniform(0.6, 1.2),
        "belly": share,
        "plate": np.clip(share * rng.uniform(1.2, 2) - rng.uniform(0.2, 0.5), 0, None),
    }[kind]
    radius = base + (1 - base) * share
    if kind == "belly":
        radius += rng.uniform(0.1, 0.35) * min(1.0, height) * np.sin(np.pi * share)
    z = height * (rise - rise[0]) / (rise[-1] - rise[0])
    side = np.stack([radius, z], -1)
    thick = rng.uniform(*wall) * min(1.0, 3 * height)
    return shell(np.concatenate([[[0, 0]], side]), thick)


def _lid(rng: np.random.Generator) -> Manifold:
    """A shallow dome, hollow below, with a knob and perhaps a flange."""
    outer, cavity = _vessel(rng, rng.uniform(0.1, 0.4), foot=(0.2, 0.6), wall=(0.03, 0.06))
    height = top(outer)
    dome = (outer - cavity).rotate([180, 0, 0]).translate([0, 0, height])
    radius, stem = rng.uniform(0.1, 0.25), rng.uniform(0.05, 0.25)
    stalk = cylinder(radius * rng.uniform(0.4, 0.9), stem + 0.05, 24).translate([0, 0, height - 0.05])
    knob = superquadric([radius, radius, radius * rng.uniform(0.3, 1.0)], (rng.uniform(0.4, 1.0), 1.0), 24)
    lid = dome + stalk + knob.translate([0, 0, height + stem])
    if chance(rng, 0.4):
        ring = cylinder(1.0 + rng.uniform(0.03, 0.1), 0.05) - cylinder(0.93, 0.05)
        lid += ring
    return lid


def _goblet(rng: np.random.Generator) -> Manifold:
    """A cup on a stem with a foot, or a dish or cake stand."""
    outer, cavity = _vessel(rng, log_uniform(rng, 0.3, 2.5), foot=(0.25, 0.7), wall=(0.04, 0.08))
    reach, foot, thin = rng.uniform(0.3, 1.6), rng.uniform(0.5, 0.9), rng.uniform(0.08, 0.2)
    knots = [[foot, 0.06], [1.3 * thin, 0.2 * reach], [thin, 0.5 * reach], [1.3 * thin, 0.9 * reach], [0.25, reach]]
    stem = revolve(np.concatenate([[[0, 0], [foot, 0]], smooth_curve(np.array(knots), 14), [[0, reach + 0.02]]]), 32)
    return (outer.translate([0, 0, reach]) + stem) - cavity.translate([0, 0, reach])


def _loop(rng: np.random.Generator, height: float) -> Manifold:
    """Handle at the side of a vessel of that ``height``: round, or with corners, or an ear."""
    span, reach = height * rng.uniform(0.35, 0.8), rng.uniform(0.4, 0.8)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 20)
    power = rng.uniform(0.35, 1.0)
    out = 0.8 + (reach + 0.15) * np.cos(angle) ** power
    path = np.stack([out, np.sin(angle) * np.abs(np.sin(angle)) ** (power - 1) * span / 2], -1)
    path[:, 1] += height * rng.uniform(0.45, 0.55) + 0.1 * rng.uniform(-1, 1) * (path[:, 0] - 0.8)
    radii = np.array([rng.uniform(0.08, 0.2), rng.uniform(0.06, 0.12)])
    return tube(path, radii, 12, rng.uniform(2, 4))


def _lip(rng: np.random.Generator, jug: Manifold, height: float) -> Manifold:
    """Pulls the rim opposite the handle out into a spout."""
    reach, width = rng.uniform(0.15, 0.5), rng.uniform(3, 7)

    def move(points: np.ndarray, share: np.ndarray) -> np.ndarray:
        angle = np.arctan2(points[:, 1], -points[:, 0])
        far = np.clip(np.linalg.norm(points[:, :2], axis=1) * 1.5 - 0.5, 0, 1)
        pull = reach * np.exp(-width * angle**2) * np.clip(share * 2 - 1, 0, 1) ** 2 * far
        return points - np.outer(pull, [1, 0, -0.2 * height / 2])

    return warp(jug.refine_to_length(0.25 * height), move)


def _pan_handle(rng: np.random.Generator, height: float) -> Manifold:
    """One long handle near the rim, rising outwards."""
    length, radii = rng.uniform(1.0, 2.2), rng.uniform(0.08, 0.18, (3, 2)) * [1, 0.7]
    handle = rod(length, radii, exponent=rng.uniform(2, 4))
    handle = bend(handle, rng.uniform(-0.4, 0.4)) if chance(rng, 0.5) else handle.translate([0, 0, -length / 2])
    if chance(rng, 0.4):
        hole = prism(regular(16) * 0.05, 1.0).rotate([0, 90, 0]).translate([-0.5, 0, 0.38 * length])
        handle -= hole
    tilt = 90 - rng.uniform(0, 25)
    return handle.rotate([0, tilt, 0]).translate([0.85 + length / 2, 0, height * 0.8 + length * 0.004 * (90 - tilt)])
