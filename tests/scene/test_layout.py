import json
from dataclasses import replace

import numpy as np
import pytest

from pwm_gym.errors import PwmGymError, SceneError, UnknownNameError, unknown_name
from pwm_gym.scene import FIXED, Entity, Joint, Layout, Mimic, Support

SLIDE = Joint("prismatic", "hand", (0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.0, 0.04)
HINGE = Joint("revolute", "box", lower=-1.0, upper=1.0)
COUNTS = [("hand", 30), ("finger", 20), ("cube", 50)]
LAYOUT = Layout.build(COUNTS, driven=("hand", "finger"), joints={"finger": SLIDE}, supports=[Support.ground(0.2)])


def layout_of(**joints):
    """Entities of five points each that hang as told."""
    return Layout.build([(name, 5) for name in joints], joints=joints)


def test_slices_follow_one_another_and_ids_name_their_entity():
    assert [(e.start, e.stop, e.points) for e in LAYOUT] == [(0, 30, 30), (30, 50, 20), (50, 100, 50)]
    assert LAYOUT.points == 100
    assert np.bincount(LAYOUT.ids).tolist() == [30, 20, 50]
    assert (np.diff(LAYOUT.ids) >= 0).all()
    assert LAYOUT.index("cube") == 2 and LAYOUT["finger"].driven and not LAYOUT["cube"].driven


def test_joints_tell_the_parts_that_entities_play(worlds):
    layout = worlds["two arms"].layout

    def names(places):
        return [layout.names[i] for i in places]

    assert names(layout.hands) == ["left_hand", "right_hand"]
    assert len(layout.driven) == 10
    assert names(layout.loose) == ["cube"]
    assert names(layout.articulated) == ["drawer"]
    assert names(layout.attached) == ["left_nail", "right_nail", "handle"]  # not the cabinet, which the world holds
    assert layout.robot().names == tuple(names(layout.driven)) and layout.robot().supports == ()


def test_articulated_parts_come_after_what_they_hang_on():
    layout = layout_of(stopper=replace(HINGE, parent="cover"), cover=replace(HINGE, parent="box"), box=FIXED)
    assert [layout.names[i] for i in layout.articulated] == ["cover", "stopper"]
    assert [layout.depth(i) for i in range(3)] == [2, 1, 0]
    assert [layout.root(i) for i in range(3)] == [2, 2, 2]


@pytest.mark.parametrize("name", ["cube", "drawer", "lid", "two arms", "pot", "bolted hand", "no arm"])
def test_json_round_trip(worlds, name):
    layout = worlds[name].layout
    again = Layout.from_json(json.loads(json.dumps(layout.to_json())))
    assert again == layout and hash(again) == hash(layout)
    assert again.supports == (Support.ground(),)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ({"lid": HINGE}, r"the joint of 'lid' has parent 'box'; expected one of lid"),
        ({"box": replace(HINGE, parent="box")}, r"joints make a circle: box on box"),
        (
            {"a": replace(HINGE, parent="b"), "b": Joint("fixed", "c"), "c": replace(HINGE, parent="a")},
            r"joints make a circle: a on b on c on a",
        ),
        ({"box": FIXED, "lid": replace(HINGE, mimic=Mimic("cover"))}, r"'lid' follows that of 'cover', which is no"),
        (
            {"box": FIXED, "lid": replace(HINGE, mimic=Mimic("box"))},
            r"'lid' follows that of 'box', which does not move",
        ),
        ({"box": FIXED, "lid": replace(HINGE, mimic=Mimic("lid"))}, r"'lid' follows itself"),
        (
            {"box": FIXED, "a": HINGE, "b": replace(HINGE, mimic=Mimic("a")), "c": replace(HINGE, mimic=Mimic("b"))},
            r"'c' follows that of 'b', which follows another",
        ),
    ],
)
def test_joints_that_do_not_fit_each_other_are_refused(joints, message):
    with pytest.raises(SceneError, match=message):
        layout_of(**joints)


def test_a_robots_joint_follows_none_of_the_scenes():
    with pytest.raises(SceneError, match=r"'finger' follows that of 'lid', which the robot does not move"):
        Layout.build(
            [("hand", 5), ("finger", 5), ("lid", 5)],
            driven=("hand", "finger"),
            joints={"finger": replace(SLIDE, mimic=Mimic("lid")), "lid": replace(HINGE, parent=None)},
        )


def test_entities_that_do_not_fit_each_other_are_refused():
    with pytest.raises(SceneError, match="two entities are called 'cube'"):
        Layout.build([("cube", 5), ("cube", 5)])
    with pytest.raises(SceneError, match="'cube' has points 6 to 9; expected to begin at 5"):
        Layout((Entity("hand", 0, 5), Entity("cube", 6, 9)))
    with pytest.raises(SceneError, match="'cube' has points 0 to 0"):
        Layout.build([("cube", 0)])
    with pytest.raises(UnknownNameError, match="unknown entity 'hnd'.*Did you mean 'hand'"):
        Layout.build(COUNTS, driven=("hnd",))
    with pytest.raises(UnknownNameError, match="unknown entity 'fingr'.*Did you mean 'finger'"):
        Layout.build(COUNTS, joints={"fingr": SLIDE})


def changed(*path_and_value):
    """JSON of a layout of a hand and a finger with one value replaced."""
    *path, last, value = path_and_value
    data = json.loads(json.dumps(LAYOUT.to_json()))
    place = data
    for key in path:
        place = place[key]
    place[last] = value
    return data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (3, r"layout: Expected `object`, got `int`"),
        (None, "layout: Expected `object`"),
        ({}, "layout: Object missing required field `entities`"),
        ({"entities": [{"name": "cube"}]}, r"missing required field `start` - at `\$\.entities\[0\]`"),
        (changed("entities", 0, "name", 7), r"Expected `str`, got `int` - at `\$\.entities\[0\]\.name`"),
        (changed("entities", 0, "stop", "many"), r"Expected `int`, got `str`"),
        (changed("entities", 0, "stop", 20), "'finger' has points 30 to 50; expected to begin at 20"),
        (changed("entities", 1, "joint", "kind", "screw"), r"Invalid enum value 'screw' - at .*joint\.kind"),
        (changed("entities", 1, "joint", "axis", [0, 1]), r"length 3.*joint\.axis"),
        (changed("entities", 1, "joint", "axis", [0, 3, 0]), r"length 3\.000; expected 1"),
        (changed("entities", 1, "joint", "upper", -1), r"joint limits 0\.0 to -1\.0"),
        (changed("entities", 1, "joint", "parent", "arm"), "has parent 'arm'"),
        (changed("supports", [3]), r"layout: .*at `\$\.supports\[0\]`"),
        ([{"name": "cube"}], "missing required field `start`"),  # of version 0.1
        ([{"name": "f", "start": 0, "stop": 3, "slider": {"parent": "hand"}}], "has parent 'hand'"),
        ([3], "layout: Expected `object`, got `array`"),
    ],
)
def test_json_that_does_not_fit_is_one_clear_error(data, message):
    with pytest.raises(SceneError, match=message) as found:
        Layout.from_json(data)
    assert str(found.value).startswith("layout: ") and "\n" not in str(found.value)


def test_a_layout_of_version_0_1_loads():
    slider = {"parent": "hand", "origin": [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], "axis": [0.0, 1.0, 0.0], "upper": 0.04}
    old = [
        {"name": "hand", "start": 0, "stop": 30, "effector": True, "slider": None},
        {"name": "finger", "start": 30, "stop": 50, "effector": True, "slider": slider},
        {"name": "cube", "start": 50, "stop": 100, "effector": False, "slider": None},
    ]
    assert Layout.from_json(old) == replace(LAYOUT, supports=(Support.ground(),))  # whose table was at height 0


@pytest.mark.parametrize("points", [3, 10, 33, 99, 100])
def test_resize_keeps_total_proportions_and_roles(points):
    smaller = LAYOUT.resize(points)
    assert smaller.points == points
    assert smaller.names == LAYOUT.names and smaller["finger"].joint == SLIDE
    assert smaller.supports == LAYOUT.supports
    for e, full in zip(smaller, LAYOUT, strict=True):
        assert 0 < e.points <= full.points
        assert abs(e.points - full.points * points / 100) <= 1


def test_resize_leaves_every_entity_a_point():
    uneven = Layout.build([("a", 1), ("hand", 100), ("b", 1), ("c", 2)])
    for points in range(4, 105):
        smaller = uneven.resize(points)
        assert smaller.points == points
        assert all(0 < e.points <= full.points for e, full in zip(smaller, uneven, strict=True))


@pytest.mark.parametrize("points", [-1, 0, 2, 101])
def test_resize_refuses_what_cannot_be(points):
    with pytest.raises(PwmGymError, match=f"points={points}; expected a whole number from 3 to 100"):
        LAYOUT.resize(points)


def test_truncate_keeps_at_most_so_many_points_each():
    assert [e.points for e in LAYOUT.truncate(25)] == [25, 20, 25]
    assert LAYOUT.truncate(10**9) == LAYOUT


def test_further_entities_follow_and_some_can_be_chosen():
    more = LAYOUT.plus([Entity("ball", 7, 17)])
    assert (more["ball"].start, more["ball"].stop) == (100, 110)
    assert more.only(("ball", "hand")).names == ("hand", "ball")
    assert more.only(("ball",))["ball"].slice == slice(0, 10)
    with pytest.raises(SceneError, match="has parent 'hand'"):
        LAYOUT.only(("finger",))


def test_the_floor_is_the_highest_plane():
    assert LAYOUT.floor == pytest.approx(0.2)
    table = Support((0.5, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0), (0.3, 0.3, 0.2))
    assert not table.plane and table.top == pytest.approx(0.3)
    assert replace(LAYOUT, supports=(*LAYOUT.supports, Support.ground(0.1), table)).floor == pytest.approx(0.2)
    assert replace(LAYOUT, supports=(table,)).floor < -100


def test_an_unknown_entity_is_answered_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"known: cube, finger, hand\. Did you mean 'cube'\?"):
        LAYOUT["cubee"]


def test_unknown_name_lists_the_known_ones_and_guesses_only_what_is_near():
    assert str(unknown_name("cost", "xyz", ["b", "a"])) == "unknown cost 'xyz'; known: a, b."
    assert str(unknown_name("cost", "xyz", [])) == "unknown cost 'xyz'; known: none."
    assert "Did you mean 'pick_cube'?" in str(unknown_name("cost", "pickcube", ["pick_cube", "stack"]))
