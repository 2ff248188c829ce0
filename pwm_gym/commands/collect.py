"""``pwm-gym collect``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from pwm_gym.collection import CollectConfig
from pwm_gym.commands.crew import crew
from pwm_gym.errors import PwmGymError

__all__ = ["Collect"]


@dataclass(frozen=True)
class Collect:
    """Collect episodes in the simulator. A run that was killed goes on where it was."""

    ray: str | None = None
    """Ray cluster whose machines collect instead: "auto", "local" or HOST:PORT (the extra "ray")."""
    config: Annotated[CollectConfig, tyro.conf.arg(name="")] = field(default_factory=CollectConfig)

    def run(self) -> None:
        """Collect, with a progress bar."""
        from pwm_gym.collection import collect

        if self.ray is not None and self.config.warp:
            raise PwmGymError(f"ray={self.ray!r} and warp={self.config.warp}; expected one of them")

        print(f"data set: {collect(self.config, workers=crew(self.config.workers, self.ray))}")
