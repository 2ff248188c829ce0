import gc
import weakref

import pytest

from pwm_gym.sim.maniskill import garbage


class Node:
    """Something that refers to itself."""

    def __init__(self):
        self.own = self


@pytest.fixture
def builds(monkeypatch):
    """Counts of builds begin anew: the first one collects."""
    monkeypatch.setattr(garbage, "_builds", iter(range(100)))


def test_garbage_is_collected_at_every_eighth_build(builds):
    alive = []
    for _ in range(9):
        node = weakref.ref(Node())
        with garbage.seldom_collected():
            gc.collect()
        alive.append(node() is not None)
        gc.collect()
        assert node() is None  # left out for a while, not for good
    assert [k for k, left in enumerate(alive) if not left] == [0, 8]


def test_what_others_froze_stays_frozen(builds):
    next(garbage._builds)
    gc.freeze()
    try:
        frozen = gc.get_freeze_count()
        with garbage.seldom_collected():
            pass
        assert gc.get_freeze_count() > 0.9 * frozen > 0  # what ends meanwhile is frozen no longer
    finally:
        gc.unfreeze()


def test_an_error_leaves_nothing_frozen(builds):
    next(garbage._builds)
    with pytest.raises(ValueError, match="no scene"), garbage.seldom_collected():
        raise ValueError("no scene")
    assert gc.get_freeze_count() == 0
