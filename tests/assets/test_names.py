import pytest

from pwm_gym.assets import UNSEEN_PREFIXES, YCB_OBJECTS, splits
from pwm_gym.assets.names import check_ycb_name
from pwm_gym.errors import UnknownNameError


def test_every_held_out_number_is_one_object():
    found = splits()
    assert len(found["unseen"]) == len(UNSEEN_PREFIXES) == 10
    assert {name.split("_")[0] for name in found["unseen"]} == set(UNSEEN_PREFIXES)
    assert sorted(found["seen"] + found["unseen"]) == list(YCB_OBJECTS)


def test_families_are_held_out_whole():
    seen = splits()["seen"]
    assert not [
        name for name in seen if "bleach" in name or "windex" in name or "screwdriver" in name or "hammer" in name
    ]
    assert not [name for name in seen if "colored_wood_blocks" in name]


def test_generated_shapes_are_seen():
    assert splits(["shape_box", "011_banana"]) == {"seen": ("shape_box",), "unseen": ("011_banana",)}


def test_an_unknown_object_is_named_with_the_nearest():
    with pytest.raises(UnknownNameError, match="unknown YCB object '048_hamer'.*Did you mean '048_hammer'"):
        check_ycb_name("048_hamer")
