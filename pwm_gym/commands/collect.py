"""``pwm-gym collect``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from pwm_gym.collection import CollectConfig

__all__ = ["Collect"]


@dataclass(frozen=True)
class Collect:
    """Collect episodes in the simulator. A run that was killed goes on where it was."""

    config: Annotated[CollectConfig, tyro.conf.arg(name="")] = field(default_factory=CollectConfig)

    def run(self) -> None:
        """Collect, with a progress bar."""
        from pwm_gym.collection import collect

        print(f"data set: {collect(self.config)}")
