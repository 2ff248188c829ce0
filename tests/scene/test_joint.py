from dataclasses import replace

import pytest

from pwm_gym.errors import SceneError
from pwm_gym.scene import Joint, Mimic

HINGE = Joint("revolute", "box", axis=(0.0, 0.6, 0.8), lower=-1.0, upper=2.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "ball"}, r"joint kind 'ball'; expected one of free, fixed, prismatic, revolute"),
        ({"kind": "free"}, r"a free joint has no parent; got 'box'"),
        ({"lower": 3.0}, r"joint limits 3\.0 to 2\.0; expected the lower one first"),
        ({"kind": "prismatic", "upper": -1.5}, r"joint limits -1\.0 to -1\.5"),
        ({"lower": float("nan")}, "not finite"),
        ({"upper": float("inf")}, "not finite"),
        ({"axis": (0.0, 0.0, float("nan"))}, "not finite"),
        ({"axis": (0.0, 0.0, 2.0)}, r"has length 2\.000; expected 1"),
        ({"axis": (0.0, 0.0, 0.0)}, r"has length 0\.000; expected 1"),
        ({"origin": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)}, "quaternion that is not of unit length"),
        ({"origin": (0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)}, "quaternion that is not of unit length"),
    ],
)
def test_what_is_no_joint_is_refused(change, message):
    with pytest.raises(SceneError, match=message):
        replace(HINGE, **change)


def test_limits_and_axes_only_count_where_something_moves():
    assert Joint("fixed", "box", lower=1.0, upper=-1.0, axis=(0.0, 0.0, 0.0)).kind == "fixed"
    assert replace(HINGE, lower=2.0).lower == HINGE.upper  # a joint that is locked


def test_which_joints_move():
    assert [Joint(kind).moves for kind in ("free", "fixed")] == [False, False]
    assert HINGE.moves and replace(HINGE, kind="prismatic").moves


def test_whole_numbers_are_as_good_as_others():
    whole = Joint("revolute", "box", (0, 0, 0, 1, 0, 0, 0), (0, 0, 1), 0, 1, Mimic("other", 2, 1))
    assert whole == Joint("revolute", "box", lower=0.0, upper=1.0, mimic=Mimic("other", 2.0, 1.0))
    assert all(isinstance(x, float) for x in (*whole.origin, *whole.axis, whole.lower, whole.mimic.multiplier))
