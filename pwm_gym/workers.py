"""Work in several processes at once that ends where one of them dies: of this machine, or of many (by Ray)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Protocol, TypeVar

from pwm_gym.errors import PwmGymError

__all__ = ["Processes", "Workers", "work_through"]

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")


class Workers(Protocol):
    """Those who work through jobs."""

    def work_through(
        self, work: Callable[[_Job], _Result], jobs: Sequence[_Job], begin: Callable[[], None] | None = None
    ) -> Iterator[_Result]:
        """Results as of :func:`work_through`."""


def work_through(
    work: Callable[[_Job], _Result],
    jobs: Sequence[_Job],
    workers: int | Workers = 1,
    begin: Callable[[], None] | None = None,
) -> Iterator[_Result]:
    """Results of ``work`` on each of the jobs, as they are done.

    Args:
        work: picklable; keeps what it made in files, so that a run that ends early goes on where it was.
        jobs: picklable.
        workers: processes of this machine at most, or others (:class:`pwm_gym.cluster.RayWorkers`). With one, or for
            one job, this process works itself.
        begin: called first in each process.

    Raises:
        PwmGymError: a process died; jobs that have not begun are given up.
    """
    crew = Processes(workers) if isinstance(workers, int) else workers
    return crew.work_through(work, jobs, begin)


@dataclass(frozen=True)
class Processes:
    """Processes of this machine."""

    count: int
    """How many at most."""

    def work_through(
        self, work: Callable[[_Job], _Result], jobs: Sequence[_Job], begin: Callable[[], None] | None = None
    ) -> Iterator[_Result]:
        """Results as of :func:`work_through`."""
        if self.count <= 1 or len(jobs) <= 1:
            yield from map(work, jobs)
            return
        count = min(self.count, len(jobs))
        # An executor, since a pool waits for ever where one of its processes dies.
        with ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=begin) as pool:
            futures = [pool.submit(work, job) for job in jobs]
            try:
                for future in as_completed(futures):
                    yield future.result()
            except BrokenProcessPool as error:
                raise PwmGymError(
                    f"one of {count} processes died (killed, or out of memory); the same command goes on where it was"
                ) from error
            finally:
                pool.shutdown(cancel_futures=True)
