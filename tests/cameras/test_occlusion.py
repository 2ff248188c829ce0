import numpy as np
import pytest
from scipy import ndimage

from pwm_gym.cameras.occlusion import occlude
from pwm_gym.errors import PwmGymError

V, U = np.mgrid[:64, :64]
DISC = (V - 30) ** 2 + (U - 34) ** 2 < 20**2  # 1245 pixels


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.6, 0.9])
def test_the_share_is_hidden_and_nothing_is_added(share):
    for seed in range(40):
        left = occlude(DISC, share, np.random.default_rng(seed))
        assert not (left & ~DISC).any()
        assert 1.0 - left.sum() / DISC.sum() == pytest.approx(share, abs=0.01)


def test_what_is_hidden_is_one_piece():
    for seed in range(40):
        hidden = DISC & ~occlude(DISC, 0.3, np.random.default_rng(seed))
        assert ndimage.label(hidden, np.ones((3, 3)))[1] == 1


def test_occluders_come_from_sides_and_also_cross_the_object():
    pieces, centres = [], []
    for seed in range(60):
        left = occlude(DISC, 0.3, np.random.default_rng(seed))
        pieces.append(ndimage.label(left)[1])
        centres.append(np.argwhere(DISC & ~left).mean(0) - [30, 34])
    assert pieces.count(1) > 10 and pieces.count(2) > 10
    sides = np.sign(centres)  # (60, 2)
    assert all((sides == corner).all(1).sum() > 5 for corner in ([1, 1], [1, -1], [-1, 1], [-1, -1]))


def test_something_is_always_left():
    thin = np.zeros((64, 64), bool)
    thin[10, 5:45] = True  # one row: whole columns of a mask can lie on an occluder's edge
    single = np.zeros((64, 64), bool)
    single[3, 4] = True
    for seed in range(40):
        for mask in (DISC, thin, single):
            assert 1 <= occlude(mask, 1.0, np.random.default_rng(seed)).sum() <= 2
    empty = np.zeros((64, 64), bool)
    assert not occlude(empty, 0.5, np.random.default_rng(0)).any()


def test_the_generator_decides_the_occluder():
    first, again, other = (occlude(DISC, 0.4, np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).sum() > 50


def test_bad_input_is_named():
    with pytest.raises(PwmGymError, match="share is 1.5; expected 0 to 1"):
        occlude(DISC, 1.5, np.random.default_rng(0))
    with pytest.raises(PwmGymError, match=r"shape \(64, 64\) and type float64; expected \(H, W\) and bool"):
        occlude(DISC.astype(float), 0.5, np.random.default_rng(0))
