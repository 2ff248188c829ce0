"""Collection of episodes: who acts, and parallel processes that record it."""

from pwm_gym.collection.collect import collect
from pwm_gym.collection.config import CollectConfig

__all__ = ["CollectConfig", "collect"]
