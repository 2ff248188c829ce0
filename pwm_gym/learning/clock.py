"""What a training took, over all the sessions of it."""

from __future__ import annotations

import time

__all__ = ["Clock"]


class Clock:
    """Counts from where it is made, and on from what earlier sessions of the same training counted."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        self._before = {"minutes": 0.0, "cpu_minutes_a_process": 0.0}

    def resume(self, spent: dict[str, float]) -> None:
        """Add what an earlier session had ``spent``."""
        self._before = dict(spent)

    def spent(self) -> dict[str, float]:
        """Minutes by the clock, pauses left out, and minutes that this process computed on all its threads."""
        return {
            "minutes": self._before["minutes"] + (time.perf_counter() - self._wall) / 60,
            "cpu_minutes_a_process": self._before["cpu_minutes_a_process"] + (time.process_time() - self._cpu) / 60,
        }
