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


@pytest.mark.parametrize("off", [-14.0, -3.0, 0.0, 5.0, 14.0])
def test_a_boxs_sides_tell_its_direction(off):
    rng = np.random.default_rng(0)
    sides = rng.uniform(-1.0, 1.0, (600, 3)) * [0.11, 0.12, 0.05]
    face = rng.integers(0, 2, 600)
    sides[np.arange(600), face] = np.sign(sides[np.arange(600), face]) * np.array([0.11, 0.12])[face]
    turn, told = np.radians(25.0), np.radians(25.0 + off)
    cos, sin = np.cos(turn), np.sin(turn)
    cloud = sides @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + [0.6, 0.1, 0.05]
    front = torch.tensor([[[np.cos(told)], [np.sin(told)], [0.0]]], dtype=torch.float32)
    x, y, z = squared(torch.tensor(cloud[None], dtype=torch.float32), front).flatten().tolist()
    assert abs(np.degrees(np.arctan2(y, x)) - 25.0) < 0.5
    assert z == 0.0
    assert x**2 + y**2 == pytest.approx(1.0, abs=1e-5)
