"""How an agent is trained by reinforcement learning."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from tyro.conf import Suppress

from pwm_gym.errors import PwmGymError, check_whole, is_number, unknown_name

__all__ = ["ALGORITHMS", "WORLDS", "AgentConfig"]

ALGORITHMS = ("ppo", "sac")
WORLDS = ("model", "sim")
_OBSERVATIONS = ("poses", "points")
_ENVS: Mapping[tuple[str, str], int] = MappingProxyType(
    {("ppo", "model"): 1024, ("sac", "model"): 64, ("ppo", "sim"): 2, ("sac", "sim"): 2}
)
"""Environments at once of each algorithm and world, where nothing else is asked for."""
_BATCH = 16_384  # steps of all environments between two updates of PPO


@dataclass(frozen=True)
class AgentConfig:
    """Settings of :func:`pwm_gym.agents.train`.

    Raises:
        PwmGymError: a number that cannot be.
        UnknownNameError: an algorithm, a world or an observation that there is not.
    """

    algorithm: Suppress[str] = "ppo"
    """"ppo" or "sac", of stable-baselines3."""
    world: Suppress[str] = "model"
    """Where it learns: in the world "model", or in its simulator twin, "sim"."""
    checkpoint: str = "default"
    """The world model's folder or a shipped name."""
    init: str = ""
    """Folder of a run whose policy, critics included, training starts from: of the same task, algorithm, observation
    and width. So an agent goes on in another world, or in a model that was trained further."""
    steps: int = 5_000_000
    """Environment steps in all."""
    minutes: float = 0.0
    """Training ends after so many minutes, too, however many steps that was; 0 sets no limit."""
    num_envs: int = 0
    """Environments at once; 0 takes what suits the algorithm and the world."""
    observation: str = "poses"
    """What it sees: entity "poses", or "points" beside them (a small PointNet)."""
    points: int = 0
    """Points of a scene; 0 takes the task's. Rewards are formed of these points, too."""
    scenes: int = 0
    """Initial scenes, drawn from the simulator's training seeds; 0 takes the checkpoint's own."""
    demonstrations: str = ""
    """Folder of a data set whose demonstrations :attr:`scenes` are drawn from instead; none where empty."""
    underway: float = 0.5
    """Share of those scenes that are somewhere in a demonstration, at rest: the end of a long task is learned from the
    first update on. The others begin where the task does."""
    episode_steps: int = 50
    """Longer episodes are truncated; what would come after counts all the same."""
    caution: float = 0.0
    """In the model: reward taken off for a metre of its expected error, all entities together, at each step."""
    discount: float = 0.9
    """Of a reward one step later."""
    learning_rate: float = 5e-4
    """Adam's at the start; it falls linearly to a tenth."""
    rollout: int = 0
    """PPO's steps of each environment between two updates; 0 takes what suits their number."""
    width: int = 256
    """Channels of the two hidden layers."""
    exploration: float = 0.4
    """PPO's first standard deviation of actions."""
    snapshot_every: int = 500_000
    """Environment steps between saved policies; 0 saves the last alone."""
    seed: int = 0
    """Of scenes, weights and exploration."""
    threads: int = 2
    """PyTorch threads."""
    device: str = "cpu"
    """PyTorch device."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        named = (("algorithm", ALGORITHMS), ("world", WORLDS), ("observation", _OBSERVATIONS))
        for name, known in named:
            if getattr(self, name) not in known:
                raise unknown_name(name, str(getattr(self, name)), known)
        least = {
            "steps": 1,
            "num_envs": 0,
            "points": 0,
            "scenes": 0,
            "rollout": 0,
            "episode_steps": 1,
            "width": 1,
            "threads": 1,
        }
        for name, bound in {**least, "snapshot_every": 0}.items():
            check_whole(name, getattr(self, name), bound)
        for name in ("minutes", "caution"):
            if not is_number(value := getattr(self, name)) or not 0.0 <= value < math.inf:
                raise PwmGymError(f"{name}={value!r}; expected a finite number of at least 0")
        if not is_number(self.underway) or not 0.0 <= self.underway <= 1.0:
            raise PwmGymError(f"underway={self.underway!r}; expected a share, 0 to 1")
        if self.demonstrations and not (self.scenes and self.world == "model"):
            told = f"scenes={self.scenes} in the {self.world}"
            raise PwmGymError(f"demonstrations={self.demonstrations!r} and {told}; expected some scenes in the model")
        if self.caution and self.world != "model":
            raise PwmGymError(f"caution={self.caution} in the {self.world}; expected the model, which tells its error")
        for name, top in (("discount", 1.0), ("learning_rate", 1.0), ("exploration", 10.0)):
            if not is_number(value := getattr(self, name)) or not 0.0 < value < top:
                raise PwmGymError(f"{name}={value!r}; expected a number between 0 and {top:g}")

    @property
    def environments(self) -> int:
        """Environments at once."""
        return self.num_envs or _ENVS[self.algorithm, self.world]

    def settings(self) -> dict[str, Any]:
        """Arguments of stable-baselines3's algorithm."""
        rate = self.learning_rate
        shared = {
            "learning_rate": lambda left: rate * (0.1 + 0.9 * left),
            "gamma": self.discount,
            "seed": self.seed,
            "device": self.device,
        }
        if self.algorithm == "sac":
            return {
                **shared,
                "learning_starts": min(100 * self.environments, self.steps // 4),
                "buffer_size": 300_000,
                "batch_size": 512,
                "train_freq": 1,
                "gradient_steps": max(1, self.environments // 8),
                "tau": 0.01,
            }
        rollout = self.rollout or max(16, (_BATCH if self.world == "model" else _BATCH // 8) // self.environments)
        return {
            **shared,
            "n_steps": rollout,
            "batch_size": max(rollout * self.environments // 8, 2),
            "n_epochs": 6,
            "gae_lambda": 0.9,
            "target_kl": 0.05,
            "max_grad_norm": 0.5,
        }
