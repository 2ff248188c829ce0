"""Training of world models on data sets: losses, fits of known responses, checkpoints."""

from pwm_gym.training.fit import FitConfig, fit, fit_baseline, fit_error
from pwm_gym.training.losses import TrainConfig, rollout_loss, train

__all__ = ["FitConfig", "TrainConfig", "fit", "fit_baseline", "fit_error", "rollout_loss", "train"]
