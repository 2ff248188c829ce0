"""``pwm-gym train``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from pwm_gym.training import FitConfig
from pwm_gym.training.losses import TrainConfig

__all__ = ["Train", "resolved"]


@dataclass(frozen=True)
class Train:
    """Train a world model on collected episodes; ``torchrun --nproc-per-node 2 -m pwm_gym train`` shares the work."""

    fit: Annotated[FitConfig, tyro.conf.arg(name="")] = field(default_factory=FitConfig)
    training: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)

    paper: bool = False
    """Train with the paper's table (H = 15, AdamW 1e-4, StepLR, Huber on velocities in metres) instead; of the options
    of training, only seed, threads, validation and device then count."""

    def run(self) -> None:
        """Train, with a progress bar, TensorBoard curves and checkpoints."""
        from pwm_gym.evaluation import validation_metrics
        from pwm_gym.learning import is_main_process
        from pwm_gym.training import fit

        training = self.training
        if self.paper:
            kept = {k: getattr(training, k) for k in ("seed", "threads", "validate_every", "device")}
            training = replace(TrainConfig.paper(), **kept)
        config = resolved(self.fit)
        main = is_main_process()  # before anything is read: an error where torchrun did not start it
        checkpoint = fit(config, training, validation_metrics)
        if main:
            print(f"checkpoint: {checkpoint}")


def resolved(config: FitConfig) -> FitConfig:
    """The same settings with the task that the data sets are of, and a folder named after all of their tasks."""
    from pwm_gym.data.dataset import read_header

    if not config.data:
        return config
    tasks = list(dict.fromkeys(_task_of(read_header(folder)) for folder in config.data))
    out = Path("runs") / "+".join(tasks) if config.out is None else config.out
    return replace(config, task=config.task if config.task in tasks else tasks[0], out=out)


def _task_of(header: Any) -> str:
    """Task of a data set, by its header."""
    settings = header["settings"] if isinstance(header, dict) else header.settings
    return str(settings["task"])
