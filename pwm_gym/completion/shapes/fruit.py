"""Random balls, eggs, fruit and vegetables."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pwm_gym.completion.draws import chance, log_uniform, turn_angles
from pwm_gym.completion.shapes.primitives import (
    bend,
    rod,
    shear_taper,
    superquadric,
    top,
    tube,
    union,
    warp,
)

__all__ = ["fruit"]


def fruit(rng: np.random.Generator) -> Manifold:
    """A ball, egg, or a fruit or vegetable: like an apple, pear, lemon, strawberry, banana or pepper."""
    makers = (_ball, _ball, _egg, _apple, _pear, _lemon, _strawberry, _banana, _banana, _pumpkin)
    return makers[rng.integers(len(makers))](rng)


def _ball(rng: np.random.Generator) -> Manifold:
    """A ball: true, a little out of round, or with a few shallow furrows around it."""
    ball = superquadric(rng.uniform(0.96, 1.0, 3), sides=60)
    if chance(rng, 0.3):
        for _ in range(int(rng.integers(1, 4))):
            angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
            furrow = tube(np.stack([np.cos(angle), np.sin(angle)], -1), np.array([0.05, 0.04]), 6, closed=True)
            ball -= furrow.rotate(turn_angles(rng))
    return ball


def _egg(rng: np.random.Generator) -> Manifold:
    """An ellipsoid or another superquadric, perhaps narrower at one end."""
    radii = [1.0, rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0)]
    solid = superquadric(radii, (rng.uniform(0.4, 1.5), rng.uniform(0.4, 1.5)), 56)
    solid = solid.rotate([0, 90, 0]) if chance(rng, 0.5) else solid
    solid = shear_taper(solid, 0.0, rng.uniform(0.4, 1.0))
    height = top(solid) - solid.bounding_box()[2]
    return bend(solid, rng.uniform(0, 0.35) * height) if chance(rng, 0.3) else solid


def _pome(
    rng: np.random.Generator, radii: tuple[float, float], dips: tuple[float, float], squeeze: float = 0.0
) -> Manifold:
    """A ball of ``radii`` (across, along z) with dips at its lower and upper pole and a little unevenness."""
    phase, uneven = rng.uniform(0, 6.3, 2), rng.uniform(0, 0.04, 2)

    def move(points: np.ndarray, share: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        angle, flat = np.arctan2(y, x), np.hypot(x, y)
        sink = np.where(z > 0, dips[1], -dips[0]) * np.exp(-((flat / 0.35) ** 2))
        wide = radii[0] * (1 - squeeze * share**1.5)
        wide = wide * (1 + flat * (uneven[0] * np.cos(2 * angle + phase[0]) + uneven[1] * np.cos(5 * angle + phase[1])))
        return np.stack([x * wide, y * wide, (z - sink) * radii[1]], -1)

    return warp(Manifold.sphere(1.0, 56), move)


def _stalk(rng: np.random.Generator, length: float, radius: float) -> Manifold:
    return bend(rod(length, np.array([[radius, radius], [0.7 * radius] * 2]), 0.1, 8), rng.uniform(-0.8, 0.8))


def _apple(rng: np.random.Generator) -> Manifold:
    """An apple, peach, tomato or orange: dipped at its poles, with or without a stalk."""
    tall = rng.uniform(0.75, 1.05)
    dips = rng.uniform(0.0, 0.15), rng.uniform(0.05, 0.35)
    solid = _pome(rng, (1.0, tall), dips, rng.uniform(-0.1, 0.2))
    if chance(rng, 0.4):
        solid += _stalk(rng, 0.5, 0.05).translate([0, 0, tall * (1 - dips[1]) + 0.15])
    return solid


def _pear(rng: np.random.Generator) -> Manifold:
    """A pear, aubergine or avocado: a wide lower and a narrow upper part."""
    tall, neck, centre = rng.uniform(1.1, 2.0), rng.uniform(0.35, 0.7), rng.uniform(0.5, 0.75)
    body = _pome(rng, (1.0, tall), (0.05, 0.0))

    def narrow(points: np.ndarray, share: np.ndarray) -> np.ndarray:
        thin = 1 - (1 - neck) / (1 + np.exp(-12 * (share - centre)))
        return points * np.stack([thin, thin, np.ones_like(thin)], -1)

    body = warp(body, narrow)
    if chance(rng, 0.5):
        body += _stalk(rng, 0.5, 0.06).translate([0, 0, tall + 0.1])
    return bend(body, rng.uniform(-0.5, 0.5))


def _lemon(rng: np.random.Generator) -> Manifold:
    """A lemon or lime: an ellipsoid with a nipple at one or both ends."""
    tips = rng.uniform(-0.3, -0.1), rng.uniform(-0.3, 0.0)
    return _pome(rng, (1.0, rng.uniform(1.05, 1.5)), tips, rng.uniform(-0.1, 0.1))


def _strawberry(rng: np.random.Generator) -> Manifold:
    """A strawberry, fig or carrot: round above, tapering to a blunt tip below, with leaves or not."""
    tall, slim = log_uniform(rng, 0.9, 4.0), rng.uniform(0.4, 0.8)
    body = _pome(rng, (1.0, tall), (0.0, 0.12), -slim).scale([1.0, rng.uniform(0.8, 1.0), 1.0])
    if chance(rng, 0.5):
        leaf = bend(rod(0.7, np.array([[0.1, 0.05], [0.14, 0.05], [0.02, 0.03]]), 0.05, 8), rng.uniform(0.3, 1.2))
        leaf = leaf.rotate([0, 100, 0]).translate([0.35, 0, 0])
        leaves = union([leaf.rotate([0, 0, 72.0 * k]) for k in range(5)])
        body += leaves.scale([1 + slim] * 3).translate([0, 0, 0.97 * tall])
    return body


def _banana(rng: np.random.Generator) -> Manifold:
    """A banana, cucumber, bean or chilli: long, bent, with blunt or drawn-out ends, round or with edges."""
    length, sides = rng.uniform(3.0, 9.0), int(rng.integers(5, 8)) if chance(rng, 0.5) else 20
    radii = np.array([rng.uniform(0.3, 0.8), 1.0, 1.1, rng.uniform(0.7, 1.0), rng.uniform(0.15, 0.6)])
    body = rod(length, np.stack([radii, rng.uniform(0.85, 1.0) * radii], -1), rng.uniform(0.05, 0.2), sides)
    if sides < 10:
        body = body.smooth_out(60).refine(3)
    return bend(body, rng.uniform(0.0, min(2.2, 0.5 * length)))


def _pumpkin(rng: np.random.Generator) -> Manifold:
    """A pumpkin, pepper, garlic bulb or plum: with lengthwise furrows."""
    lobes, depth = int(rng.choice([1, 3, 4, 5, 8])), rng.uniform(0.05, 0.2)
    solid = _pome(rng, (1.0, rng.uniform(0.6, 1.5)), (0.1, rng.uniform(0.0, 0.3)), rng.uniform(-0.2, 0.4))

    def furrow(points: np.ndarray, _share: np.ndarray) -> np.ndarray:
        angle = np.arctan2(points[:, 1], points[:, 0])
        thin = 1 - depth * (1 - np.abs(np.sin(lobes * angle / 2))) ** 2 * np.minimum(np.hypot(*points.T[:2]), 1)
        return points * np.stack([thin, thin, np.ones_like(thin)], -1)

    solid = warp(solid, furrow)
    return solid + _stalk(rng, 0.6, 0.1).translate([0, 0, top(solid)]) if chance(rng, 0.5) else solid
