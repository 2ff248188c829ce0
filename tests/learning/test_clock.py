"""What a training took."""

import time

from pwm_gym.learning import Clock


def test_a_clock_goes_on_from_what_earlier_sessions_spent():
    clock = Clock()
    begun = time.process_time()
    while time.process_time() - begun < 0.05:
        pass
    first = clock.spent()
    assert 0.05 / 60 <= first["cpu_minutes_a_process"] <= 1.2 * first["minutes"]
    later = Clock()
    later.resume(first)
    again = later.spent()
    assert all(first[name] <= again[name] < first[name] + 0.01 for name in first)
