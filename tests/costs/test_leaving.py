"""Carrying an object, letting it go and leaving it, and reaching into a drawer, which planning costs ask for."""

from functools import cache

import numpy as np
import pytest
import torch
import trimesh

from pwm_gym.costs import contacts, drawers, objects, terms
from pwm_gym.scene import sample_surface
from pwm_gym.sim.cabinets import LOW_CABINET


def cloud(mesh, at, count=1500):
    return torch.as_tensor(sample_surface(mesh, count, 0) + np.asarray(at), dtype=torch.float32).unsqueeze(0)


@cache
def box_points(sides, count=400):
    """Points (1, n, 3) of a box about the origin."""
    return cloud(trimesh.creation.box(sides), (0.0, 0.0, 0.0), count)


@cache
def solid_points(boxes, count=4000):
    """Points (1, n, 3) of a solid of boxes."""
    return cloud(trimesh.util.concatenate([box(part.size, part.centre) for part in boxes]), (0.0, 0.0, 0.0), count)


def box(sides, at):
    return trimesh.creation.box(sides, trimesh.transformations.translation_matrix(at))


def gripper(tool, opening=0.08):
    """Clouds (1, n, 3) of fingers that close along y, and of their hand, about a tool centre."""
    half = opening / 2 + 0.0135
    parts = {
        "hand": ((0.06, 0.2, 0.066), (0, 0, 0.0767)),
        "left_gripper": ((0.02, 0.027, 0.05), (0, half, 0.0201)),
        "right_gripper": ((0.02, 0.027, 0.05), (0, -half, 0.0201)),
    }
    return {
        name: box_points(sides) + torch.tensor(np.add(at, tool), dtype=torch.float32)
        for name, (sides, at) in parts.items()
    }


MUG = cloud(trimesh.creation.cylinder(0.03, 0.08), (0.5, 0.1, 0.04))


def mug_and(tool):
    return {**gripper(tool), "mug": MUG}


def test_a_hand_leaves_an_object_upwards():
    clear, low = objects.hand_clear("mug"), objects.hand_low("mug")
    heights = [0.05, 0.08, 0.10, 0.13]
    scenes = [mug_and((0.5, 0.1, z)) for z in heights]
    assert [bool(clear(s, {})) for s in scenes] == [False, False, False, True]
    shares = [float(low(s, {})) for s in scenes]
    assert shares == sorted(shares, reverse=True) and shares[0] > 0.5 and shares[-1] == 0.0


def test_a_hand_that_is_beside_an_object_has_left_it():
    assert bool(objects.hand_clear("mug")(mug_and((0.5, -0.1, 0.05)), {}))


@pytest.mark.parametrize("degrees", [0.0, 1.0, 6.0, 15.0])
def test_a_tilted_hand_costs_what_it_is_beyond_two_degrees(degrees):
    axis = [1.0, 2.0, 0.0]  # of no finger's
    turn = trimesh.transformations.rotation_matrix(np.radians(degrees), axis, (0.5, 0.1, 0.3))
    rotation, shift = (torch.as_tensor(part, dtype=torch.float32) for part in (turn[:3, :3], turn[:3, 3]))
    points = {name: cloud @ rotation.T + shift for name, cloud in gripper((0.5, 0.1, 0.3)).items()}
    expected = max(np.sin(np.radians(degrees)) - np.sin(np.radians(2.0)), 0.0)
    assert float(terms.tilt(points, {})) == pytest.approx(expected, abs=0.012)


def test_a_held_object_gains_by_coming_nearer_from_any_distance():
    held = {**gripper((0.5, 0.1, 0.04), opening=0.06), "mug": MUG}
    info = {"velocity": {name: torch.zeros_like(points) for name, points in held.items()}}
    info["action"] = torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]])

    def gain(distance):
        target = contacts.centre(held, "mug") + torch.tensor([[distance, 0.0, 0.0]])
        return float(objects.carry_onto("mug", lambda points, info: target, clearance=0.08)(held, info))

    gains = [gain(distance) for distance in np.linspace(0.9, 0.0, 40)]
    assert gains[0] > 0.0 and (np.diff(gains) > 0.005).all()
    assert gains[-1] == pytest.approx(5.0, abs=0.6)  # of which a firm grasp gets nearly all


def drawer_scene(tool, opening, way):
    """An open drawer, and a gripper that has ``way`` still to go; the drawer opens along x."""
    place = np.array(LOW_CABINET.joint.origin[:3]) + [0.14, 0.0, 0.0]
    points = {
        **gripper(tool, opening),
        "cabinet": solid_points(LOW_CABINET.body),
        "drawer": solid_points(LOW_CABINET.drawer) + torch.tensor(place, dtype=torch.float32),
    }
    blocking = drawers.fingers_blocking(drawers.CABINET_DRAWER, lambda points, info: torch.tensor([way]))
    return float(blocking(points, {}))


@pytest.mark.parametrize(
    ("beside", "opening", "blocked"),
    [(0.0, 0.08, False), (0.03, 0.08, False), (0.06, 0.08, True), (0.06, 0.015, False), (-0.06, 0.08, True)],
)
def test_open_fingers_do_not_fit_beside_a_trays_side(beside, opening, blocked):
    place = (0.1, beside, 0.0)
    assert LOW_CABINET.tray[1][1] == pytest.approx(0.103)  # half its width; an open finger reaches 6.7 cm from the tool
    for tool in (place, (0.0, 0.0, 0.3)):
        told = drawer_scene(tool, opening, np.subtract(place, tool).astype(np.float32).tolist())
        assert (told > 0.9) if blocked else (told == 0.0), told
