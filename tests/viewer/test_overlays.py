import numpy as np
import pytest

from pwm_gym.errors import PwmGymError
from pwm_gym.viewer import draw_overlays


def test_a_sheet_has_a_strip_an_episode_in_both_colours(record):
    one = draw_overlays([record], "failures", panel=80, steps=4)
    three = draw_overlays([record] * 3, "failures", panel=80, steps=4)
    assert one.width == 4 * 84 - 4 + 40 and three.width == 2 * (4 * 84 - 4) + 60
    assert three.height - one.height == 24 + 80 + 4  # two lines
    red, green, _ = np.moveaxis(np.asarray(three.convert("RGB"), int), -1, 0)
    assert (green - red > 30).mean() > 1e-3 and (red - green > 30).mean() > 1e-3


def test_a_sheet_of_nothing_is_named():
    with pytest.raises(PwmGymError, match="no episodes to draw"):
        draw_overlays([], "failures")
