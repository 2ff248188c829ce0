"""Terms of costs that push an object to its goal."""

import pytest
import torch

from pwm_gym.costs import pushes
from pwm_gym.robots.gripper import FETCH

CONTACT = 0.04


def at(x, y, z, spread=0.0):
    """A cloud (1, 2, 3) about a place."""
    return torch.tensor([[[x - spread, y, z], [x + spread, y, z]]])


def scene(tool, goal, velocity=0.0):
    """Points and info: an object at the origin, the tool's centre at a place, the fingers' and the hand's over it."""
    x, y, z = tool
    rise = 0.02
    points = {
        "object": at(0.0, 0.0, 0.0, 0.02),
        "left_gripper": at(x, y + 0.01, z + rise),
        "right_gripper": at(x, y - 0.01, z + rise),
        "hand": at(x, y, z + rise + rise / FETCH.tool_ratio),
    }
    moved = {"object": torch.tensor([[[velocity, 0.0, 0.0]] * 2])}
    return points, {"goal": torch.tensor([goal]), "velocity": moved}


def test_the_tool_belongs_behind_the_object():
    term = pushes.behind("object", FETCH, CONTACT)
    assert float(term(*scene((-CONTACT, 0.0, 0.0), (0.3, 0.0, 0.0)))) == pytest.approx(0.0, abs=1e-6)
    assert float(term(*scene((CONTACT, 0.0, 0.0), (0.3, 0.0, 0.0)))) == pytest.approx(2 * CONTACT)


def test_a_low_tool_before_the_object_costs_and_a_high_one_does_not():
    term = pushes.wrong_side("object", FETCH, CONTACT)
    before, behind, above = (
        float(term(*scene(place, (0.3, 0.0, 0.0))))
        for place in ((CONTACT, 0.0, 0.0), (-CONTACT, 0.0, 0.0), (CONTACT, 0.0, 0.08))
    )
    assert before > 0.05 and behind == 0.0 and above < 1e-4


def test_a_sliding_object_counts_where_it_comes_to_rest():
    slide = pushes.Slide(slow=0.001, fast=0.002, fast_from=0.012)
    speed, stop = 0.04, 0.0
    while speed > 0.0:
        speed -= slide.fast if speed > slide.fast_from else slide.slow
        stop += max(speed, 0.0)
    points, info = scene((0.0, 0.0, 0.2), (stop, 0.0, 0.0), velocity=0.04)
    left = float(pushes.goal_distance("object", slide)(points, info))
    assert left < 5.0 * 0.004 + 0.2  # within 4 mm
    at_rest = scene((0.0, 0.0, 0.2), (0.0, 0.0, 0.0), velocity=0.0)
    assert float(pushes.goal_distance("object", slide)(*at_rest)) == 0.0
    assert float(pushes.goal_distance("object")(points, info)) == pytest.approx(5.0 * stop + 1.0, abs=1e-3)


def test_a_tool_at_the_upper_edge_presses_and_a_low_or_a_clear_one_does_not():
    term = pushes.pressing("object", FETCH, CONTACT)
    low, edge, clear, far = (
        float(term(*scene(place, (0.3, 0.0, 0.0))))
        for place in ((-CONTACT, 0.0, 0.0), (-CONTACT, 0.0, 0.035), (-CONTACT, 0.0, 0.07), (-0.2, 0.0, 0.035))
    )
    assert edge == pytest.approx(0.03, rel=0.05)
    assert low == clear == 0.0 and far < 1e-6
    higher = pushes.pressing("object", FETCH, CONTACT, clear=0.08)
    assert float(higher(*scene((-CONTACT, 0.0, 0.07), (0.3, 0.0, 0.0)))) == pytest.approx(0.01, rel=0.05)
