import copy
import json
from dataclasses import asdict, replace

import pytest

from pwm_gym.errors import CheckpointError, PwmGymError, UnknownNameError
from pwm_gym.robots import Arm, Channel, Control
from pwm_gym.robots.panda import PANDA

CHAIN = PANDA.control.arms[0].chain
MOVE = Channel("translation", 0, 3, 0.1, arm="arm")
GRIP = Channel("gripper", 3, 4, rest=1.0, arm="arm")
HAND = Arm("arm", "hand", CHAIN)


def test_size_kinds_and_rest_follow_the_channels(worlds):
    four, two = worlds["four"].control, worlds["two arms"].control
    assert four.size == 4 and four.rest() == (0.0, 0.0, 0.0, 1.0)
    assert four.kinds == ("translation",) * 3 + ("gripper",)
    assert four.channel("arm", "rotation") is None
    assert two.size == 24 and two.rest() == (0.0,) * 24
    assert two.channel("right", "rotation").slice == slice(15, 18)
    assert [c.slice for c in two.of_kind("finger")] == [slice(6, 12), slice(18, 24)]
    assert [c.kind for c in two.of_arm("left")] == ["translation", "rotation", "finger"]
    assert Control().size == 0 and Control().rest() == ()


def test_arms_take_their_joints_one_after_the_other():
    control = Control(arms=(HAND, Arm("other", "claw", CHAIN, first_joint=9), Arm("third", "hook")))
    assert [arm.joints for arm in control.arms] == [slice(0, 7), slice(9, 16), slice(0, 0)]


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ((replace(GRIP, stop=5),), r"'gripper' takes components 3 to 5 of the action; expected them to begin at 0"),
        ((MOVE, replace(GRIP, start=2)), r"components 2 to 4 of the action; expected them to begin at 3"),
        ((MOVE, replace(GRIP, start=4, stop=5)), r"components 4 to 5 of the action; expected them to begin at 3"),
        ((replace(MOVE, stop=0),), r"components 0 to 0"),
        ((replace(MOVE, stop=2),), r"'translation' has 2 components; expected 3"),
        ((Channel("rotation", 0, 4),), r"'rotation' has 4 components; expected 3"),
        ((MOVE, replace(MOVE, start=3, stop=6)), r"two channels 'translation' of arm 'arm'; expected one"),
        ((Channel("rotation", 0, 3), Channel("rotation", 3, 6)), r"two channels 'rotation' of no arm; expected one"),
    ],
)
def test_channels_that_do_not_fit_are_refused(channels, message):
    with pytest.raises(PwmGymError, match=message):
        Control(channels, (HAND,))


@pytest.mark.parametrize(
    ("arms", "message"),
    [
        ((HAND, Arm("arm", "claw")), "two arms have the same name: arm, arm"),
        ((HAND, Arm("other", "hand")), "two arms have the same hand: hand, hand"),
        ((HAND, Arm("other", "claw", CHAIN)), r"'other' shares joints \[0, 1, 2, 3, 4, 5, 6\] with another arm"),
        ((HAND, Arm("other", "claw", CHAIN, 6)), r"'other' shares joints \[6\] with another arm"),
        ((replace(HAND, first_joint=-1),), "'arm' has joints from -1; expected 0 or more"),
    ],
)
def test_arms_that_do_not_fit_each_other_are_refused(arms, message):
    with pytest.raises(PwmGymError, match=message):
        Control((MOVE, GRIP), arms)


def test_a_channel_of_an_unknown_arm_is_refused():
    with pytest.raises(UnknownNameError, match="unknown arm 'arms'; known: arm. Did you mean 'arm'"):
        Control((replace(MOVE, arm="arms"),), (HAND,))


@pytest.mark.parametrize("period", [0.0, -1.0, float("nan")])
def test_time_goes_on(period):
    with pytest.raises(PwmGymError, match=f"period={period}; expected more than 0 seconds"):
        Control(period=period)


@pytest.mark.parametrize("name", ["cube", "four", "two arms", "bolted hand", "no arm"])
def test_json_round_trip(worlds, name):
    control = worlds[name].control
    assert Control.from_json(json.loads(json.dumps(control.to_json()))) == control


def test_a_control_of_version_0_1_loads():
    chain = {**asdict(CHAIN), "position_unit": 0.1, "rotation_unit": -0.1}
    old = json.loads(json.dumps({"vectors": [[0, 3], [3, 6]], "arm": chain}))
    given = copy.deepcopy(old)
    assert Control.from_json(old) == PANDA.control
    assert old == given  # and is left as it was
    assert Control.from_json({"vectors": [], "arm": None}) == Control()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (None, "control: Expected `object`, got `null`"),
        ([], "control: Expected `object`, got `array`"),
        ({"channels": [{"kind": "warp", "start": 0, "stop": 1}]}, r"Invalid enum value 'warp' - at `\$\.channels\[0\]"),
        ({"channels": [{"kind": "finger", "start": 1, "stop": 2}]}, "expected them to begin at 0"),
        ({"channels": [{"kind": "finger", "start": 0, "stop": 1, "arm": "x"}]}, "unknown arm 'x'"),
        ({"arms": [{"name": "arm"}]}, "missing required field `hand`"),
        ({"period": "fast"}, r"Expected `float`, got `str` - at `\$\.period`"),
        ({"vectors": [], "arm": {"tool": 3}}, "control: "),
        ({"vectors": [], "arm": asdict(CHAIN)}, "control: "),  # of version 0.1, without its units
    ],
)
def test_json_that_does_not_fit_is_one_clear_error(values, message):
    with pytest.raises(CheckpointError, match=message) as found:
        Control.from_json(values)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("lost", ["mount", "rest", "lower"])
def test_a_chain_whose_parts_differ_in_number_is_refused(lost):
    values = PANDA.control.to_json()
    values["arms"][0]["chain"][lost] = values["arms"][0]["chain"][lost][:-1]
    with pytest.raises(CheckpointError, match="control: "):
        Control.from_json(values)
