import numpy as np
import pytest

from pwm_gym.data import bank_of, underway_bank


def test_a_bank_holds_the_scenes_that_it_was_made_of(train_split):
    bank = bank_of(train_split, [1, 0, 1], [0, 2, 5])
    for row, (episode, step) in enumerate([(1, 0), (0, 2), (1, 5)]):
        true, scene = train_split.scene(train_split.episodes[episode], step), bank.scene(row)
        assert np.array_equal(scene.poses[0], true.poses[0]) and np.array_equal(scene.goal, true.goal)
        assert np.array_equal(scene.joints[0], true.joints[0]) and not scene.joints[1].any()
        assert np.array_equal(scene.clouds, true.clouds)


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_scenes_underway_come_before_success(train_split, share):
    shown = train_split.of_kinds(("expert", "randomised"))
    bank = underway_bank(shown, 300, share)
    first = {e.poses[0].tobytes() for e in shown.episodes}
    before = set()
    for e in shown.episodes:
        ends = [len(e) - 1, *np.flatnonzero(e.success)[:1]] + ([] if e.switch < 0 else [e.switch])
        before |= {e.poses[k].tobytes() for k in range(min(ends) + 1)}
    found = [poses.tobytes() for poses in bank.poses]
    assert {*found} <= before
    later = np.mean([each not in first for each in found])
    assert abs(later - share) < 0.12
    assert {*found} == first if share == 0.0 else len({*found}) > 60
