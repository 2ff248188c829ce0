"""Collection of episodes: who acts, and parallel processes that record it."""

from pwm_gym.collection.collect import CollectConfig, collect

__all__ = ["CollectConfig", "collect"]
