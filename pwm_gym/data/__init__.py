"""Episodes: collection, storage, and the windows that training reads."""

from pwm_gym.data.collect import CollectConfig, collect
from pwm_gym.data.dataset import Dataset, Windows, load_split
from pwm_gym.data.episodes import KINDS, Episode
from pwm_gym.data.fitting import FitConfig, fit, fit_baseline, fit_error

__all__ = [
    "KINDS",
    "CollectConfig",
    "Dataset",
    "Episode",
    "FitConfig",
    "Windows",
    "collect",
    "fit",
    "fit_baseline",
    "fit_error",
    "load_split",
]
