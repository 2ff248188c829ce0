"""Settings of a collection."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pwm_gym.errors import DatasetError

__all__ = ["CollectConfig"]


@dataclass(frozen=True)
class CollectConfig:
    """What to collect.

    Raises:
        DatasetError: a number that cannot be.
    """

    task: str = "PickCube"
    """Registered task."""
    objects: str = ""
    """What episodes draw their objects from, where they differ: one of the task's sets, such as "liftable", or an
    object's name; the task's default if not given."""
    out: Path | None = None
    """Folder of the data set; None takes ``data-sets/`` and the task's name. A run that was killed goes on where it
    was."""
    episodes: int = 1000
    """Training episodes; validation and test get a tenth as many each, at least ``held_out``."""
    held_out: int = 20
    """Episodes of validation, and of test, at least."""
    practice: float = 0.5
    """Share of practice episodes; what is left of both shares are demonstrations."""
    on_policy: float = 0.0
    """Share of training episodes that a planner or a policy runs in the simulator. A planner succeeds sooner than the
    expert, so that they are short, but planning each takes half a minute."""
    checkpoint: str = "default"
    """Whose model plans the on-policy episodes: a folder or a shipped checkpoint's name."""
    policy: str = ""
    """What acts in the on-policy episodes instead: a folder of ``pwm-gym train-agent``, or another policy that
    ``pwm-gym rank`` takes. So a model learns where an agent goes that was trained in it."""
    offset: int = 0
    """First seed of each split, so that several data sets of a task share none."""
    randomise: float = 0.2
    """Share of demonstrations that switch to random actions at a random step (the paper's 20 %)."""
    jitter: float = 0.0
    """Largest standard deviation of the noise that is added to what an expert, a planner or a policy asks of arms, in
    action units, so that data hold small mistakes and how they are put right."""
    mirrored: float = 0.0
    """Share of episodes in scenes that are mirrored between the robot's left and right, for tasks whose furniture
    stands on one side always. Their goals stay."""
    workers: int = 2
    """Processes."""
    shard: int = 20
    """Episodes a file."""
    warp: int = 0
    """Worlds that this process steps at once by MuJoCo Warp (the extra "warp"), on a GPU where there is one, in the
    place of ``workers``; tasks of MuJoCo alone. 0 collects with the task's own simulator."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        least_of = {"episodes": 1, "held_out": 1, "workers": 1, "shard": 1, "offset": 0, "warp": 0}
        for name, least in least_of.items():
            if getattr(self, name) < least:
                raise DatasetError(f"{name}={getattr(self, name)}; expected at least {least}")
        for name in ("practice", "on_policy", "randomise", "jitter", "mirrored"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise DatasetError(f"{name}={getattr(self, name)}; expected a share from 0 to 1")
        if self.practice + self.on_policy > 1.0:
            raise DatasetError(f"practice={self.practice} and on_policy={self.on_policy}; expected at most 1 together")
        if self.policy and not self.on_policy:
            raise DatasetError(f"policy={self.policy!r} and on_policy={self.on_policy}; expected a share for it")
        if self.warp and self.on_policy:
            raise DatasetError(
                f"warp={self.warp} and on_policy={self.on_policy}; expected one of them: plans share a planner"
            )
        if self.warp and self.mirrored:
            raise DatasetError(f"warp={self.warp} and mirrored={self.mirrored}; expected one of them")

    @property
    def folder(self) -> Path:
        """Folder of the data set."""
        return Path("data-sets") / self.task if self.out is None else self.out
