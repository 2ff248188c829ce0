"""Work on many machines, by Ray (the extra ``ray``).

All machines have the package, and see the folder that the command is started in and the folders that it is told of, by
the same paths: a shared file system. What is made is kept there, as by the processes of one machine.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pwm_gym.errors import PwmGymError

__all__ = ["RayWorkers"]

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")
_PATIENCE = 10.0  # seconds until a cluster's machine answers
_RETRIES = 1  # of a job whose machine or process was lost
_BEGUN: set[Callable[[], None]] = set()  # what this process has called before its first job


@dataclass(frozen=True)
class RayWorkers:
    """The processors of a Ray cluster, a job each; implements :class:`pwm_gym.workers.Workers`."""

    address: str = "auto"
    """"auto" for the cluster that this machine belongs to, "local" for one of this machine alone, which is started for
    the while, or ``host:port`` or ``ray://host:port``."""

    def work_through(
        self, work: Callable[[_Job], _Result], jobs: Sequence[_Job], begin: Callable[[], None] | None = None
    ) -> Iterator[_Result]:
        """Results as of :func:`pwm_gym.workers.work_through`.

        Raises:
            PwmGymError: Ray is missing, there is no such cluster, or machines of it were lost.
        """
        if not jobs:
            return
        ray = _library()
        own = not ray.is_initialized()
        if own:
            self._connect(ray)
        task = ray.remote(num_cpus=1, max_retries=_RETRIES)(_work)
        waiting = [task.remote(work, job, begin, Path.cwd()) for job in jobs]
        try:
            while waiting:
                done, waiting = ray.wait(waiting, num_returns=1)
                yield _result(ray, done[0])
        finally:
            for job in waiting:
                ray.cancel(job)
            if own:
                ray.shutdown()

    def _connect(self, ray: Any) -> None:
        settings = {"include_dashboard": False} if self.address == "local" else {}
        try:
            self._knock()
            ray.init(self.address, log_to_driver=False, logging_level="ERROR", **settings)
        except (OSError, RuntimeError, ValueError) as error:
            reason = str(error).strip().partition("\n")[0]
            raise PwmGymError(
                f"no Ray cluster at {self.address!r} ({reason}); start one by `ray start --head`, or use 'local'"
            ) from error

    def _knock(self) -> None:
        """Raise an error at once where nobody answers, for which Ray takes minutes."""
        host, colon, port = self.address.removeprefix("ray://").rpartition(":")
        if colon:
            socket.create_connection((host, int(port)), _PATIENCE).close()


def _work(work: Callable[[_Job], _Result], job: _Job, begin: Callable[[], None] | None, folder: Path) -> _Result:
    """One job, on whatever machine."""
    if not folder.is_dir():
        raise PwmGymError(f"{os.uname().nodename} does not see {folder}; expected a file system that machines share")
    os.chdir(folder)
    if begin is not None and begin not in _BEGUN:
        begin()
        _BEGUN.add(begin)
    return work(job)


def _result(ray: Any, job: Any) -> Any:
    """What a job gave; its own error where it raised one."""
    try:
        return ray.get(job)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    except ray.exceptions.RayError as error:
        reason = str(error).strip().partition("\n")[0]
        raise PwmGymError(f"a process of the cluster died ({reason}); the same command goes on where it was") from error


def _library() -> Any:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise PwmGymError(f"{error}; work on many machines needs Ray: pip install 'pwm-gym[ray]'") from error
    return ray
