"""Names of the YCB objects, and which of them are kept out of training."""

from __future__ import annotations

from collections.abc import Iterable

from pwm_gym.errors import unknown_name

__all__ = ["GENERATED_PREFIX", "UNSEEN_PREFIXES", "YCB_OBJECTS", "check_ycb_name", "is_unseen", "splits"]

GENERATED_PREFIX = "shape_"
"""Begins the names of generated shapes; YCB's names begin with a number."""

UNSEEN_PREFIXES = ("011", "021", "022", "028", "038", "043", "044", "048", "070-a", "070-b")
"""Numbers of the held-out objects: whole families (bottles, tools, wood blocks) and three single objects."""

_SINGLE = """
001_chips_can 002_master_chef_can 003_cracker_box 004_sugar_box 005_tomato_soup_can 006_mustard_bottle
007_tuna_fish_can 008_pudding_box 009_gelatin_box 010_potted_meat_can 011_banana 012_strawberry 013_apple 014_lemon
015_peach 016_pear 017_orange 018_plum 019_pitcher_base 021_bleach_cleanser 022_windex_bottle 023_wine_glass 024_bowl
025_mug 026_sponge 027-skillet 028_skillet_lid 029_plate 030_fork 031_spoon 032_knife 033_spatula 035_power_drill
036_wood_block 037_scissors 038_padlock 039_key 040_large_marker 041_small_marker 042_adjustable_wrench
043_phillips_screwdriver 044_flat_screwdriver 046_plastic_bolt 047_plastic_nut 048_hammer 049_small_clamp
050_medium_clamp 051_large_clamp 052_extra_large_clamp 053_mini_soccer_ball 054_softball 055_baseball 056_tennis_ball
057_racquetball 058_golf_ball 059_chain 061_foam_brick 062_dice 071_nine_hole_peg_test 076_timer 077_rubiks_cube
"""
_LETTERED = {
    "063-{}_marbles": "abcdef",
    "065-{}_cups": "abcdefghij",
    "070-{}_colored_wood_blocks": "ab",
    "072-{}_toy_airplane": "abcdefghijk",
    "073-{}_lego_duplo": "abcdefghijklm",
}
YCB_OBJECTS = tuple(
    sorted(_SINGLE.split() + [form.format(letter) for form, letters in _LETTERED.items() for letter in letters])
)
"""Names of the YCB object set, as its archives spell them."""


def check_ycb_name(name: str) -> str:
    """``name``, if it is one of :data:`YCB_OBJECTS`.

    Raises:
        UnknownNameError: it is not.
    """
    if name not in YCB_OBJECTS:
        raise unknown_name("YCB object", name, YCB_OBJECTS)
    return name


def is_unseen(name: str) -> bool:
    """Whether the YCB object ``name`` is held out of training."""
    return name.split("_")[0] in UNSEEN_PREFIXES


def splits(names: Iterable[str] = YCB_OBJECTS) -> dict[str, tuple[str, ...]]:
    """``names`` by split, "seen" and "unseen", each in alphabetical order.

    Generated shapes belong to "seen".

    Example:
        >>> splits(["048_hammer", "003_cracker_box"])
        {'seen': ('003_cracker_box',), 'unseen': ('048_hammer',)}
    """
    ordered = sorted(names)
    return {
        "seen": tuple(name for name in ordered if not is_unseen(name)),
        "unseen": tuple(name for name in ordered if is_unseen(name)),
    }
