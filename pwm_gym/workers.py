"""Work in several processes at once that ends where one of them dies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import TypeVar

from pwm_gym.errors import PwmGymError

__all__ = ["work_through"]

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")


def work_through(
    work: Callable[[_Job], _Result],
    jobs: Sequence[_Job],
    workers: int,
    begin: Callable[[], None] | None = None,
) -> Iterator[_Result]:
    """Results of ``work`` on each of the jobs, as they are done.

    Args:
        work: picklable; keeps what it made in files, so that a run that ends early goes on where it was.
        jobs: picklable.
        workers: processes at most; with one, or for one job, this process works itself.
        begin: called first in each process.

    Raises:
        PwmGymError: a process died; jobs that have not begun are given up.
    """
    if workers <= 1 or len(jobs) <= 1:
        yield from map(work, jobs)
        return
    count = min(workers, len(jobs))
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
