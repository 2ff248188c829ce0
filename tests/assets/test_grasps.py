import numpy as np
import pytest
import trimesh
from trimesh.transformations import translation_matrix

from pwm_gym.assets import generated_pieces, object_grasps
from pwm_gym.errors import PwmGymError
from pwm_gym.robots.gripper import PANDA
from pwm_gym.skills import find_grasps


def upright(known):
    return [grasp for grasp in known.grasps if grasp.approach[2] < -0.99]


def test_a_box_is_held_across_its_narrow_side_at_its_middle():
    best = find_grasps([trimesh.creation.box([0.12, 0.04, 0.03])], count=4).grasps[0]
    assert abs(best.closing[1]) > 0.99 and 0.039 < best.width < 0.044  # within one of the 24 yaws of the narrow side
    assert np.hypot(*best.position[:2]) < 0.006
    assert best.width + 0.003 <= best.opening <= PANDA.opening


@pytest.mark.parametrize("name", ["shape_bottle", "shape_disc"])
def test_fingers_stay_off_the_table_and_the_hand_over_the_object(name):
    pieces = generated_pieces(name)
    bounds = trimesh.util.concatenate(pieces).bounds
    for grasp in upright(find_grasps(pieces)):
        assert grasp.position[2] - PANDA.finger_tip > bounds[0, 2] + 0.002
        assert grasp.position[2] + PANDA.hand_height > bounds[1, 2]


def test_a_wide_block_has_poor_grasps_at_its_corners_alone_and_a_wide_tray_is_held_by_its_rim():
    block = find_grasps([trimesh.creation.box([0.12, 0.12, 0.12])]).grasps
    assert all(grasp.score < 0.5 and np.abs(grasp.position[:2]).min() > 0.02 for grasp in block)
    sides = [trimesh.creation.box([0.16, 0.006, 0.05], translation_matrix([0, y, 0])) for y in (-0.077, 0.077)] + [
        trimesh.creation.box([0.006, 0.16, 0.05], translation_matrix([x, 0, 0])) for x in (-0.077, 0.077)
    ]
    rim = upright(find_grasps(sides))[0]
    assert rim.width == pytest.approx(0.006, abs=0.001)
    assert max(np.abs(rim.position[:2])) == pytest.approx(0.077, abs=0.002)


def test_a_tall_object_has_grasps_for_when_it_has_fallen():
    known = find_grasps([trimesh.creation.box([0.05, 0.06, 0.2])], count=4)
    assert {round(abs(grasp.approach[2])) for grasp in known.grasps} == {0, 1}
    assert known.mass == pytest.approx(0.6)


def test_no_pieces_is_an_error():
    with pytest.raises(PwmGymError, match="0 pieces"):
        find_grasps([])


def test_grasps_are_kept_beside_the_object_and_found_anew_for_other_pieces(shapes, monkeypatch):
    from pwm_gym.assets import known

    first = object_grasps(shapes, "shape_bar")
    path = shapes.model("shape_bar") / "grasps.npz"
    assert path.is_file()
    known._find.cache_clear()
    monkeypatch.setattr(known, "find_grasps", lambda *_, **__: pytest.fail("searched again"))
    again = object_grasps(shapes, "shape_bar")
    assert again.grasps == first.grasps and again.mass == first.mass
    np.testing.assert_array_equal(again.cloud, first.cloud)
    with pytest.raises(PwmGymError, match="grasps of other pieces"):
        known._read(path, "another")


def test_grasps_of_a_missing_object(shapes):
    with pytest.raises(PwmGymError, match="expected convex pieces of 'shape_none'"):
        object_grasps(shapes, "shape_none")
