"""``pwm-gym train-agent``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from pwm_gym.commands.folders import data_folder, run_folder
from pwm_gym.commands.numbers import check_least
from pwm_gym.policies import CloningConfig, PolicyConfig

__all__ = ["TrainAgent"]


@dataclass(frozen=True)
class TrainAgent:
    """Train a policy by behaviour cloning on a data set's demonstrations, and test it in the simulator."""

    task: str = "PickCube"
    """Registered task."""
    data: Path | None = None
    """Folder of a data set. None takes ``data-sets/`` and the task's name."""
    out: Path | None = None
    """Folder of the policy. None takes ``runs/``, the task's name and "-cloned"."""
    demonstrations: int = 0
    """Demonstrations, evenly chosen; 0 takes all."""
    episodes: int = 20
    """Seeded episodes of the test; 0 leaves it out."""
    objects: str = ""
    """What the test's episodes draw their objects from, where they differ; the task's default if not given."""
    json: Path | None = None
    """Where to write the test's results."""
    network: PolicyConfig = field(default_factory=PolicyConfig)
    training: Annotated[CloningConfig, tyro.conf.arg(name="")] = field(default_factory=CloningConfig)

    def run(self) -> None:
        """Train, with a progress bar and TensorBoard curves, then run the test's episodes."""
        import pwm_gym  # noqa: F401  (registers)
        from pwm_gym.commands.plan import print_success
        from pwm_gym.evaluation import plan_episodes, write_results
        from pwm_gym.policies import PolicyAgent, clone, load_policy
        from pwm_gym.tasks import get_task

        check_least(self, demonstrations=0, episodes=0)
        task = get_task(self.task)
        data, out = data_folder(task.name, self.data), run_folder(f"{task.name}-cloned", self.out)
        clone(task.name, data, out, self.training, self.network, self.demonstrations)
        print(f"policy: {out}")
        if not self.episodes:
            return
        table = plan_episodes(PolicyAgent(load_policy(out), task.name), self.episodes, self.objects, progress=True)
        print_success(f"{task.name}, behaviour cloning in the simulator", table)
        if self.json is not None:
            write_results(self.json, {"demonstrations": self.demonstrations, "objects": self.objects, **table})
