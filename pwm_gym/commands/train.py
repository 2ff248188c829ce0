"""``pwm-gym train``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import tyro

from pwm_gym.training import FitConfig
from pwm_gym.training.losses import TrainConfig

__all__ = ["Train"]


@dataclass(frozen=True)
class Train:
    """Train a world model on collected episodes; ``torchrun --nproc-per-node 2 -m pwm_gym train`` shares the work."""

    fit: tyro.conf.OmitArgPrefixes[FitConfig] = field(default_factory=FitConfig)
    training: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)

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
        main = is_main_process()  # before anything is read: an error where torchrun did not start it
        checkpoint = fit(self.fit, training, validation_metrics)
        if main:
            print(f"checkpoint: {checkpoint}")
