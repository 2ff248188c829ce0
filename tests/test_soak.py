"""Memory that does not grow; `python benchmarks/soak.py --steps 100000` steps for longer."""

import mmap

import pytest
from soak import SUBJECTS, soak

STEPS, ENVIRONMENTS = 60, 2
MOST_OBJECTS = 40  # more than at the start; a leak of one a step would be 60


@pytest.mark.parametrize("name", ["batch of poses", "stable-baselines3"])
def test_stepping_keeps_nothing(name):
    found = soak(SUBJECTS[name](ENVIRONMENTS), STEPS, progress=False)
    assert found.steps == STEPS and found.objects < MOST_OBJECTS
    assert found.end_mib - found.start_mib < 5.0


def test_a_leak_is_seen():
    kept = []

    def leak():
        pages = mmap.mmap(-1, 1 << 20)  # of its own: what an allocator gives may have been resident before
        pages.write(bytes(1 << 20))
        kept.append([pages, [0]])

    found = soak(leak, STEPS, progress=False)
    assert found.objects >= STEPS and found.slope_mib > 1000.0
