"""``pwm-gym average``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

__all__ = ["Average"]


@dataclass(frozen=True)
class Average:
    """Write a checkpoint whose weights are the mean of several, each trained on from another of them."""

    checkpoints: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of the checkpoints; scenes and description are those of the last."""
    out: Path
    """Folder of the new one."""
    shares: tuple[float, ...] = ()
    """Of each in the mean; only their ratios count. None given gives all the same."""

    def run(self) -> None:
        """Write the folder."""
        from pwm_gym.dynamics import average

        average(self.checkpoints, self.out, self.shares or None)
        print(f"checkpoint: {self.out}")
