"""Episodes and data sets: storage, and the windows that training reads."""

from pwm_gym.data.banks import bank_of, underway_bank
from pwm_gym.data.batch import Batch, Batches
from pwm_gym.data.dataset import Dataset, load_demonstrations, load_split
from pwm_gym.data.episodes import DEMONSTRATIONS, KINDS, Episode
from pwm_gym.data.windows import Windows

__all__ = [
    "DEMONSTRATIONS",
    "KINDS",
    "Batch",
    "Batches",
    "Dataset",
    "Episode",
    "Windows",
    "bank_of",
    "load_demonstrations",
    "load_split",
    "underway_bank",
]
