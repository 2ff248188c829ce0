import itertools

import pytest

from pwm_gym.errors import PwmGymError
from pwm_gym.seeds import RANGES, seed_range, split_of


def test_ranges_are_disjoint():
    for a, b in itertools.combinations(RANGES.values(), 2):
        assert a[-1] < b[0] or b[-1] < a[0]


def test_a_seeds_split_is_its_range():
    for split, seeds in RANGES.items():
        assert {split_of(seeds[0]), split_of(seeds[-1]), split_of(seed_range(split, 5, 10)[0])} == {split}


def test_seed_range_takes_from_an_offset():
    assert list(seed_range("test", 3, 7)) == list(RANGES["test"][7:10])


def test_no_more_seeds_than_there_are():
    whole = len(RANGES["train"])
    assert len(seed_range("train", whole)) == whole
    with pytest.raises(ValueError, match=f"train has {whole} seeds; {whole - 1} \\+ 2 were asked for"):
        seed_range("train", 2, offset=whole - 1)
    with pytest.raises(PwmGymError, match="-5 \\+ 2 were asked for"):
        seed_range("train", 2, offset=-5)


@pytest.mark.parametrize("seed", [-1, 10**9])
def test_a_seed_of_no_split_is_refused(seed):
    with pytest.raises(ValueError, match=f"seed {seed} lies in none"):
        split_of(seed)
