"""Who works for a command: processes of this machine, or a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pwm_gym.workers import Workers

__all__ = ["crew"]


def crew(processes: int, ray: str | None) -> int | Workers:
    """So many processes of this machine, or, where an address is given, the processors of a Ray cluster."""
    if ray is None:
        return processes
    from pwm_gym.cluster import RayWorkers

    return RayWorkers(ray)
