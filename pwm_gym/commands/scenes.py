"""``pwm-gym scenes``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from pwm_gym.commands.numbers import check_least

__all__ = ["Scenes"]


@dataclass(frozen=True)
class Scenes:
    """Give a checkpoint initial scenes of a task, also of one that it was never trained on.

    ``gym.make("pwm/<task>-v0", checkpoint=FOLDER)`` then starts from them. What the checkpoint tells of its training
    stays as it is.
    """

    checkpoint: Annotated[Path, tyro.conf.Positional]
    """Folder of the checkpoint."""
    task: str = "PickCube"
    """Registered task of the checkpoint's robot."""
    count: int = 64
    """Scenes."""
    objects: str = ""
    """What episodes draw their objects from, where they differ; the task's default if not given."""

    def run(self) -> None:
        """Write ``scenes-<task>.npz`` into the folder."""
        from pwm_gym.collection.scenes import simulated_bank
        from pwm_gym.dynamics import load_checkpoint
        from pwm_gym.dynamics.checkpoint import bank_path
        from pwm_gym.tasks import get_task

        check_least(self, count=1)
        task = get_task(self.task)
        checkpoint = load_checkpoint(self.checkpoint)
        checkpoint.check_robot(task.layout, task.control)
        checkpoint.check_joints(task.layout)
        path = bank_path(self.checkpoint, task.name)
        simulated_bank(task, self.count, self.objects or None).save(path)
        known = "trained on it" if task.name in checkpoint.seen_tasks else "never trained on it"
        print(f"{path}: {self.count} scenes of {task.name}; the model was {known}")
