import numpy as np
import pytest
import torch
import trimesh

from pwm_gym.costs import contacts, objects
from pwm_gym.costs.grips import finger_overlap, grip
from pwm_gym.scene import sample_surface


def cloud(mesh, count=400):
    return torch.as_tensor(sample_surface(mesh, count, 0), dtype=torch.float32)


def box(*sides, at=(0.0, 0.0, 0.0)):
    return trimesh.creation.box(sides, trimesh.transformations.translation_matrix(at))


BAR = box(0.03, 0.16, 0.03, at=(0.0, 0.0, 0.015))
ELL = trimesh.util.concatenate([BAR, box(0.10, 0.03, 0.03, at=(0.065, -0.065, 0.015))])
RING = trimesh.creation.annulus(0.055, 0.06, 0.05, transform=trimesh.transformations.translation_matrix((0, 0, 0.025)))
CAN = trimesh.creation.cylinder(0.055, 0.05, transform=trimesh.transformations.translation_matrix((0, 0, 0.025)))


def scene(mesh, tool=(0.0, 0.0, 0.2), yaw=0.0, opening=0.08):
    """Clouds (1, n, 3) of an object and of a gripper above it, whose fingers close along x turned by ``yaw``."""
    turn = trimesh.transformations.rotation_matrix(yaw, [0, 0, 1])
    turn[:3, 3] = tool
    half = opening / 2 + 0.0135  # to the middle of a finger
    parts = {
        "hand": box(0.2, 0.06, 0.066, at=(0, 0, 0.0767)),
        "left_gripper": box(0.027, 0.02, 0.05, at=(half, 0, 0.0201)),
        "right_gripper": box(0.027, 0.02, 0.05, at=(-half, 0, 0.0201)),
    }
    found = {name: cloud(part.apply_transform(turn)).unsqueeze(0) for name, part in parts.items()}
    return {**found, "object": cloud(mesh).unsqueeze(0)}


def test_a_bar_is_held_across_its_middle():
    across, along = (grip(scene(BAR, yaw=yaw), "object") for yaw in (0.0, np.pi / 2))
    np.testing.assert_allclose(across.place[0, :2], [0, 0], atol=0.01)
    assert across.misfit < 0.05 and across.width == pytest.approx(0.03, abs=0.004)
    assert along.misfit > across.misfit + 0.2  # only over one of its ends


def test_an_l_is_held_by_one_of_its_arms():
    held = grip(scene(ELL), "object")
    assert held.misfit < 0.4 and held.width < 0.035 and abs(float(held.place[0, 0])) < 0.01
    assert float(held.place[0, 1]) > -0.05  # where the other arm is in no finger's way


def test_a_ring_is_held_by_its_rim_and_a_wide_can_is_not_held():
    rim, can = (grip(scene(mesh, tool=(0.05, 0.0, 0.2)), "object") for mesh in (RING, CAN))
    assert rim.width < 0.03 and float(rim.place[0, :2].norm()) == pytest.approx(0.057, abs=0.012)
    assert can.misfit > 0.25
    off_centre = float(rim.place[0, :2].norm()) / 0.12
    assert float(rim.misfit) == pytest.approx(off_centre, abs=0.03)  # nothing else is wrong with it


def test_a_cup_is_held_about_its_middle_not_by_a_side_that_the_pads_would_slip_off():
    cup = trimesh.creation.cylinder(0.032, 0.06, transform=trimesh.transformations.translation_matrix((0, 0, 0.03)))
    for beside in (0.0, 0.024, -0.028):  # along the fingers' pads, where the cup is narrower
        held = grip(scene(cup, tool=(0.0, beside, 0.2)), "object")
        np.testing.assert_allclose(held.place[0, :2], [0, 0], atol=0.008)
        assert held.misfit < 0.1 and held.width == pytest.approx(0.064, abs=0.004)


def test_fingers_over_what_they_would_hit_are_told():
    assert finger_overlap(scene(RING, tool=(0.0575, 0.0, 0.08)), "object") == 0.0  # one inside, one outside
    assert finger_overlap(scene(RING, tool=(0.0, 0.0, 0.08)), "object") == 1.0  # both over the rim
    assert finger_overlap(scene(BAR, tool=(0.0, 0.0, 0.08)), "object") == 0.0


def test_what_lies_beyond_a_finger_is_not_between_them():
    shut = scene(RING, tool=(0.0575, 0.0, 0.025), opening=0.005)
    gaps = contacts.pad_gaps(shut, "object")
    assert gaps.abs().max() < 0.003  # the other side of the ring does not count
    empty = contacts.pad_gaps(scene(RING, tool=(0.0, 0.0, 0.025), opening=0.0), "object")
    assert empty.min() > 1.0  # shut in the middle of the ring


def held(mesh, closing=0.0, action=-1.0, **gripper):
    """Whether the contact rule holds, and its soft form; the fingers have come ``closing`` metres closer."""
    points = scene(mesh, **gripper)
    velocity = {name: torch.zeros_like(cloud) for name, cloud in points.items()}
    velocity["left_gripper"][..., 0], velocity["right_gripper"][..., 0] = -closing / 2, closing / 2
    command = torch.tensor([[0.0] * 6 + [action]])
    rule = contacts.stopped(points, velocity, command, "object")
    return bool(rule), float(objects._firmness(points, {"velocity": velocity, "action": command}, "object"))


def test_pads_that_press_on_a_part_hold_it_and_those_shut_beside_it_do_not():
    rule, firmness = held(BAR, tool=(0.0, 0.0, 0.015), opening=0.029)
    assert rule and firmness > 0.9
    assert held(BAR, tool=(0.0, 0.0, 0.015), opening=0.029, closing=0.02)[0]  # the step in which they meet it
    assert not held(BAR, tool=(0.0, 0.0, 0.015), opening=0.034, closing=0.02)[0]  # not there yet
    assert held(BAR, tool=(0.0, 0.0, 0.015), opening=0.029, action=1.0) == (False, 0.0)
    assert held(BAR, tool=(0.0, 0.0, 0.015), opening=0.029, action=-0.3) == (True, 0.0)  # told to stop half-way
    rule, firmness = held(BAR, tool=(0.0, 0.0, 0.015), opening=0.0)  # shut in it: 30 mm through the pads
    assert not rule and firmness < 0.01


def test_tall_objects_are_held_near_their_tops():
    tall = box(0.04, 0.04, 0.2, at=(0, 0, 0.1))
    assert float(grip(scene(tall, tool=(0, 0, 0.3)), "object").place[0, 2]) == pytest.approx(0.17, abs=0.005)
