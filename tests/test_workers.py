import os

import pytest

from pwm_gym.errors import PwmGymError
from pwm_gym.workers import work_through


@pytest.mark.parametrize("workers", [1, 2])
def test_every_job_is_done(workers):
    assert sorted(work_through(abs, [-1, 2, -3], workers)) == [1, 2, 3]


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_job_is_its_own(workers):
    with pytest.raises(ValueError, match="invalid literal for int.*'x'"):
        list(work_through(int, ["1", "x"], workers))


def test_a_process_that_dies_is_an_error():
    with pytest.raises(PwmGymError, match="one of 2 processes died .* the same command goes on where it was"):
        list(work_through(os._exit, [1, 1, 1], 2))
