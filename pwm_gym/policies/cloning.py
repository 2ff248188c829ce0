"""Behaviour cloning: a policy that does what demonstrations did."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from pwm_gym.data import Dataset, load_demonstrations
from pwm_gym.errors import CheckpointError, DatasetError, PwmGymError
from pwm_gym.learning import Clock, LoopConfig, run_training
from pwm_gym.learning.weights import load_weights, read_description, rebuild, save_weights
from pwm_gym.policies.network import Policy, PolicyConfig, boxes_of
from pwm_gym.scene import SCHEMA
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.schema import convert
from pwm_gym.tasks import Task, get_task

__all__ = ["CloningConfig", "clone", "cloning_took", "load_policy"]

_FORMAT = "pwm_gym.policy"
_LEAST_SPREAD = 1e-3  # of a feature that hardly changes


@dataclass(frozen=True)
class CloningConfig(LoopConfig):
    """How a policy is trained; the extent of a phase is of no account."""

    phases: tuple[tuple[int, int, int], ...] = ((1, 6000, 256),)
    optimizer: str = "adamw"
    learning_rate: float = 1e-3
    validate_every: int = 2000
    noise: float = 0.02
    """Standard deviation of the noise on features, in units of their own."""


@dataclass(frozen=True)
class _Facts:
    """What a policy's description holds."""

    task: str
    config: PolicyConfig
    demonstrations: int


@dataclass(frozen=True)
class _Batch:
    """Features (B, F) and the demonstrations' actions (B, A)."""

    features: Tensor
    actions: Tensor

    def to(self, device: torch.device | str) -> _Batch:
        """The same on a device."""
        return _Batch(self.features.to(device), self.actions.to(device))


class _Loss(nn.Module):
    """Huber's loss of a policy's actions."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, batch: _Batch) -> Tensor:
        return nn.functional.smooth_l1_loss(self.policy(batch.features), batch.actions, beta=0.2)


def clone(
    task: str,
    data: Path,
    out: Path,
    config: CloningConfig | None = None,
    network: PolicyConfig | None = None,
    episodes: int = 0,
    progress: bool = True,
) -> Path:
    """Train a policy on a data set's demonstrations, up to where they turn random, and return its folder.

    Args:
        task: registered task.
        data: a data set of it.
        out: folder of the policy, of TensorBoard's curves and of the state that a killed run resumes from.
        config: of the training.
        network: hyper-parameters.
        episodes: demonstrations, evenly chosen; 0 takes all.
        progress: whether to show a bar.

    Raises:
        DatasetError: no such data set, or fewer demonstrations in it.
        PwmGymError: a number of episodes that cannot be.
    """
    config, known, clock = config or CloningConfig(), get_task(task), Clock()
    if episodes < 0:
        raise PwmGymError(f"episodes={episodes}; expected 0 (all) or more")
    torch.manual_seed(config.seed)
    policy = Policy(known.layout, known.action_size, known.goal_size, network)
    train = _demonstrations(data, "train", known, episodes)
    features, actions = _rows(policy, train)
    policy.mean.copy_(features.mean(0))
    policy.std.copy_(features.std(0).clamp_min(_LEAST_SPREAD))
    held_out = _Batch(*_rows(policy, _demonstrations(data, "validation", known)))
    spread = config.noise * policy.std
    device = torch.device(config.device)

    def draw(generator: torch.Generator, step: int, processes: int) -> _Batch:
        rows = torch.randint(len(features), (config.phase(step)[1] // processes,), generator=generator)
        noise = torch.randn(len(rows), policy.feature_size, generator=generator)
        return _Batch(features[rows] + spread * noise, actions[rows])

    @torch.no_grad()
    def validate(model: Any) -> dict[str, float]:
        seen = held_out.to(device)
        return {"action_error": float((model(seen.features) - seen.actions).abs().mean())}

    def save(model: nn.Module, metrics: dict[str, float]) -> None:
        described = {"task": known.name, "config": asdict(policy.config), "demonstrations": len(train.episodes)}
        training = {"settings": config.describe(), "metrics": metrics, "data_steps": len(features), **clock.spent()}
        save_weights(out, model, {"format": _FORMAT, "schema": SCHEMA, **described, "training": training})

    run_training(policy, _Loss(policy), draw, config, out, validate, save, progress, clock)
    return out


def load_policy(folder: str | Path) -> Policy:
    """A trained policy.

    Raises:
        CheckpointError: missing, damaged or foreign files.
        UnknownNameError: its task is not registered.
    """
    folder = Path(folder)
    found = read_description(folder, _FORMAT, SCHEMA, _Facts)
    task = get_task(found["task"])
    config = convert(found["config"], PolicyConfig, CheckpointError, f"{folder}: config")
    policy = rebuild(folder, asdict(config), lambda: Policy(task.layout, task.action_size, task.goal_size, config))
    load_weights(policy, folder)
    return policy


def cloning_took(folder: str | Path) -> dict[str, Any]:
    """Demonstrations and their steps that a cloned policy's training saw, and its minutes, where they are told.

    Raises:
        CheckpointError: missing, damaged or foreign files.
    """
    found = read_description(Path(folder), _FORMAT, SCHEMA, _Facts)
    kept = {key: found["training"][key] for key in ("data_steps", "minutes") if key in found.get("training", {})}
    return {"demonstrations": found["demonstrations"], **kept}


def _demonstrations(data: Path, split: str, task: Task, episodes: int = 0) -> Dataset:
    """Demonstrations of a split, evenly chosen where fewer are asked for."""
    found = load_demonstrations(data, split, task.name)
    if episodes > len(found.episodes):
        raise DatasetError(f"episodes={episodes}; {data} has {len(found.episodes)} demonstrations")
    return found.some(episodes) if episodes else found


def _rows(policy: Policy, data: Dataset) -> tuple[Tensor, Tensor]:
    """Features (M, F) and actions (M, A) of all steps that the expert took."""
    parts = list(_of_episodes(policy, data))
    return torch.cat([features for features, _ in parts]), torch.cat([actions for _, actions in parts])


def _of_episodes(policy: Policy, data: Dataset) -> Iterator[tuple[Tensor, Tensor]]:
    boxes = boxes_of(data.layout, torch.as_tensor(data.clouds))
    for episode, combination in zip(data.episodes, data.combination_of, strict=True):
        count = episode.demonstrated
        frames = matrix_from_pose7(torch.as_tensor(episode.poses[:count], dtype=torch.float64)).float()
        past = torch.arange(count).unsqueeze(1) - torch.arange(3)
        goal = torch.as_tensor(episode.goal, dtype=torch.float32).expand(count, -1)
        features = policy.features(frames[past.clamp_min(0)], boxes[combination].expand(count, -1, -1), goal)
        yield features, torch.as_tensor(episode.actions[:count], dtype=torch.float32)
