"""A policy that does what demonstrations did, before it learns by reinforcement."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback
from torch import Tensor
from torch.nn import functional as F
from tqdm import tqdm

from pwm_gym.agents.config import AgentConfig
from pwm_gym.data import Dataset, Episode
from pwm_gym.envs.common import OBSERVATIONS
from pwm_gym.policies.cloning import demonstration_steps, demonstrations_of
from pwm_gym.scene import RigidState
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.tasks import Task

__all__ = ["CriticFirst", "imitate"]

_BATCH, _RATE = 512, 1e-3
_ALONE = 5  # updates of the critic before what acts is changed
_BETA = 0.2  # of an action's component: smaller differences count by their squares


class CriticFirst(BaseCallback):
    """Leaves what acts as it was for PPO's first updates: a critic that knows nothing yet would spoil it."""

    def _on_training_start(self) -> None:
        self._updates = 0

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        policy: Any = self.model.policy
        for part in (policy.mlp_extractor.policy_net, policy.action_net):
            part.requires_grad_(self._updates >= _ALONE)
        policy.log_std.requires_grad_(self._updates >= _ALONE)
        self._updates += 1


def imitate(policy: Any, task: Task, config: AgentConfig, progress: bool = True) -> float:
    """Fit what acts of a policy of stable-baselines3's PPO to the demonstrations of a data set.

    Args:
        policy: changed in place.
        task: of the policy and of the data set.
        config: names the data set, and tells what the policy observes.
        progress: whether to show a bar.

    Returns:
        Mean absolute difference of the last steps' actions.

    Raises:
        DatasetError: no such data set, one of another task, or no demonstrations in it.
    """
    data = demonstrations_of(Path(config.demonstrations), "train", task)
    rows = [*_rows(data, task, config)]
    seen = {key: torch.cat([row[0][key] for row in rows]) for key in rows[0][0]}
    actions = torch.cat([row[1] for row in rows])
    generator = torch.Generator().manual_seed(config.seed)
    optimizer = torch.optim.Adam(policy.parameters(), _RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.imitation_steps)
    difference = float("inf")
    for _ in tqdm(range(config.imitation_steps), desc="imitate", disable=not progress):
        index = torch.randint(len(actions), (_BATCH,), generator=generator)
        mean = _mean_action(policy, {key: value[index] for key, value in seen.items()})
        wanted = actions[index].to(mean)
        loss = F.smooth_l1_loss(mean, wanted, beta=_BETA)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        schedule.step()
        difference = float((mean.detach() - wanted).abs().mean())
    return difference


def _mean_action(policy: Any, seen: dict[str, Tensor]) -> Tensor:
    """Mean (B, A) of what the policy would do."""
    seen = {key: value.to(policy.device) for key, value in seen.items()}
    observation = seen.get("", seen)
    mean: Tensor = policy.get_distribution(observation).distribution.mean
    return mean


def _rows(data: Dataset, task: Task, config: AgentConfig) -> Iterator[tuple[dict[str, Tensor], Tensor]]:
    """Observations and actions (T, A) of each demonstration; a plain observation has the key ""."""
    shown = OBSERVATIONS[config.observation]
    for episode in data.episodes:
        state = _states(data, episode)
        if config.points:
            state = state.coarsen(task.layout.resize(config.points))
        goal = torch.as_tensor(episode.goal, dtype=torch.float32).expand(len(state.frames), -1)
        seen = shown.observe(state, goal)
        actions = torch.as_tensor(episode.actions[: len(state.frames)], dtype=torch.float32)
        yield seen if isinstance(seen, dict) else {"": seen}, actions


def _states(data: Dataset, episode: Episode) -> RigidState:
    """States (T,) before each of a demonstration's actions."""
    count = demonstration_steps(episode)
    frames = matrix_from_pose7(torch.as_tensor(episode.poses[:count], dtype=torch.float64)).float()
    past = torch.arange(count).unsqueeze(1) - torch.arange(3)
    clouds = torch.as_tensor(data.cloud(episode), dtype=torch.float32).expand(count, -1, -1)
    return RigidState(data.layout, clouds, frames[past.clamp_min(0)])
