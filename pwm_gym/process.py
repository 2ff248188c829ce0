"""Settings of this process that suit rollouts of hundreds of small scenes on a CPU."""

from __future__ import annotations

import ctypes
import platform

import torch

__all__ = ["prepare_process"]

_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1  # glibc's numbers of mallopt's options
_LARGEST_MMAP, _LARGEST_TRIM = 32 << 20, 1 << 30  # bytes


def prepare_process(threads: int = 2) -> None:
    """Set PyTorch's threads, and let the process keep the memory that it frees.

    A rollout allocates and frees some hundred megabytes of intermediate values. By default glibc gives such memory back
    to the system, which then clears each page anew: a quarter of the rollout's time. Elsewhere than with glibc
    only the threads are set.

    Args:
        threads: of one operation. Beside another busy process fewer threads than cores are faster: at the end of each
            operation all of them wait for the slowest.
    """
    torch.set_num_threads(threads)
    if platform.libc_ver()[0] == "glibc":
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, _LARGEST_MMAP)
        library.mallopt(_TRIM_THRESHOLD, _LARGEST_TRIM)
