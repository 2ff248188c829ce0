"""``pwm-gym collect``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Annotated

import tyro

from pwm_gym.collection import CollectConfig
from pwm_gym.commands.crew import crew
from pwm_gym.errors import PwmGymError

if TYPE_CHECKING:
    from pwm_gym.planning import Agent
    from pwm_gym.tasks import Task

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

        print(f"data set: {collect(self.config, workers=crew(self.config.workers, self.ray), agent=self._agent())}")

    def _agent(self) -> Callable[[Task], Agent] | None:
        """Makes who acts in the on-policy episodes, if it is a policy; a wrong one ends all before anything is run."""
        if not self.config.policy:
            return None
        import pwm_gym  # noqa: F401  (registers)
        from pwm_gym.agents.contestants import contestant, contestant_agent
        from pwm_gym.tasks import get_task

        contestant(self.config.policy, get_task(self.config.task))
        return partial(contestant_agent, self.config.policy)
