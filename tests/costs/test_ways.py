"""Ways to a place from above, and directions of boxes, which costs read off points."""

import numpy as np
import pytest
import torch

from pwm_gym.costs.contacts import squared
from pwm_gym.costs.terms import way_from_above

STEP = 0.001  # metres


@pytest.mark.parametrize(
    ("clearance", "within", "slope"),
    [(0.02, 0.005, 0.04), (0.08, 0.005, 0.04), (0.065, 0.002, 0.008), (0.05, 0.015, 0.04)],
)
def test_a_way_from_above_has_no_end_but_the_place(clearance, within, slope):
    beside, height = torch.meshgrid(torch.arange(0.0, 0.3, 0.0017), torch.arange(-0.02, 0.3, 0.0017), indexing="ij")
    start = torch.stack([beside, torch.zeros_like(beside), height], -1).flatten(0, 1)
    start = start[start.norm(dim=-1) > 2 * STEP]
    moves = STEP * torch.tensor([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    here = way_from_above(start, clearance, within, slope)
    there = way_from_above(start + moves[:, None], clearance, within, slope)
    assert bool((there.amin(0) < here).all())
    assert float(way_from_above(torch.zeros(1, 3), clearance, within, slope)) == 0.0


def box_cloud(degrees):
    """Points (600, 3) on the sides of a box that is turned so."""
    rng = np.random.default_rng(0)
    sides = rng.uniform(-1.0, 1.0, (600, 3)) * [0.11, 0.12, 0.05]
    face = rng.integers(0, 2, 600)
    sides[np.arange(600), face] = np.sign(sides[np.arange(600), face]) * np.array([0.11, 0.12])[face]
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return sides @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + [0.6, 0.1, 0.05]


def towards(degrees):
    """Horizontal unit vector (3, 1)."""
    return np.array([[np.cos(np.radians(degrees))], [np.sin(np.radians(degrees))], [0.0]])


def found(clouds, fronts):
    """Directions (B, 3, 1) and angles (B,), degrees, of boxes."""
    ways = squared(*(torch.tensor(np.array(values), dtype=torch.float32) for values in (clouds, fronts)))
    return ways, torch.atan2(ways[:, 1, 0], ways[:, 0, 0]).rad2deg().numpy()


@pytest.mark.parametrize("off", [-14.0, -3.0, 0.0, 5.0, 14.0])
def test_a_boxs_sides_tell_its_direction(off):
    ways, angles = found([box_cloud(25.0)], [towards(25.0 + off)])
    assert abs(angles[0] - 25.0) < 0.5
    assert ways[0, 2] == 0.0
    assert float(ways.norm()) == pytest.approx(1.0, abs=1e-5)


def test_the_direction_of_a_box_that_stands_still_in_every_sample_is_what_each_would_tell():
    offs = [-2.0, 1.0, 3.0]
    _, together = found([box_cloud(25.0)] * 3, [towards(25.0 + off) for off in offs])
    alone = [found([box_cloud(25.0)], [towards(25.0 + off)])[1][0] for off in offs]
    np.testing.assert_allclose(together, alone, atol=0.1)
    _, turned = found([box_cloud(25.0), box_cloud(21.0)], [towards(25.0)] * 2)
    np.testing.assert_allclose(turned, [25.0, 21.0], atol=0.5)
