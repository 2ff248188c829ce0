import json

import numpy as np
import pytest

from pwm_gym.errors import PwmGymError, UnknownNameError, unknown_name
from pwm_gym.scene import Layout, Slider

SLIDER = Slider("hand", (0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.04)
LAYOUT = Layout.build(
    [("hand", 30), ("finger", 20), ("cube", 50)], driven=("hand", "finger"), sliders={"finger": SLIDER}
)


def test_slices_follow_one_another_and_ids_name_their_entity():
    assert [(e.start, e.stop, e.points) for e in LAYOUT] == [(0, 30, 30), (30, 50, 20), (50, 100, 50)]
    assert LAYOUT.points == 100
    assert np.bincount(LAYOUT.ids).tolist() == [30, 20, 50]
    assert (np.diff(LAYOUT.ids) >= 0).all()
    assert LAYOUT.index("cube") == 2 and LAYOUT["finger"].effector and not LAYOUT["cube"].effector


def test_json_round_trip_keeps_sliders():
    again = Layout.from_json(json.loads(json.dumps(LAYOUT.to_json())))
    assert again == LAYOUT
    assert again["finger"].slider == SLIDER


@pytest.mark.parametrize("points", [3, 10, 33, 99, 100])
def test_resize_keeps_total_proportions_and_roles(points):
    smaller = LAYOUT.resize(points)
    assert smaller.points == points
    assert smaller.names == LAYOUT.names and smaller["finger"].slider == SLIDER
    for e, full in zip(smaller, LAYOUT, strict=True):
        assert 0 < e.points <= full.points
        assert abs(e.points - full.points * points / 100) <= 1


@pytest.mark.parametrize("points", [-1, 0, 2, 101])
def test_resize_refuses_what_cannot_be(points):
    with pytest.raises(PwmGymError, match=f"points={points}; expected 3 to 100"):
        LAYOUT.resize(points)


def test_truncate_keeps_at_most_so_many_points_each():
    assert [e.points for e in LAYOUT.truncate(25)] == [25, 20, 25]
    assert LAYOUT.truncate(10**9) == LAYOUT


def test_an_unknown_entity_is_answered_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"known: cube, finger, hand\. Did you mean 'cube'\?"):
        LAYOUT["cubee"]


def test_unknown_name_lists_the_known_ones_and_guesses_only_what_is_near():
    assert str(unknown_name("cost", "xyz", ["b", "a"])) == "unknown cost 'xyz'; known: a, b."
    assert str(unknown_name("cost", "xyz", [])) == "unknown cost 'xyz'; known: none."
    assert "Did you mean 'pick_cube'?" in str(unknown_name("cost", "pickcube", ["pick_cube", "stack"]))
