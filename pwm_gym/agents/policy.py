"""A trained policy network in a folder, and as something that acts on scenes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.sac.policies import SACPolicy
from torch import Tensor, nn

from pwm_gym.agents.config import ALGORITHMS, AgentConfig
from pwm_gym.agents.features import EntityFeatures, PointFeatures
from pwm_gym.envs.common import OBSERVATIONS, action_space
from pwm_gym.errors import CheckpointError, PwmGymError
from pwm_gym.learning.weights import load_weights, read_description, rebuild, save_weights
from pwm_gym.policies.network import check_entities
from pwm_gym.scene import SCHEMA, Layout, RigidState
from pwm_gym.tasks import Task, get_task

__all__ = ["LearnedPolicy", "algorithm_class", "load_agent", "policy_settings", "save_agent"]

FORMAT = "pwm_gym.agent"


@dataclass(frozen=True)
class _Facts:
    """What an agent's description holds."""

    task: str
    algorithm: str
    observation: str
    points: int
    width: int
    action_size: int


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """Stable-baselines3's class of "ppo" or "sac"."""
    return {"ppo": PPO, "sac": SAC}[name]


def policy_settings(task: Task, config: AgentConfig) -> dict[str, Any]:
    """``policy_kwargs`` of stable-baselines3's algorithm."""
    layout = _layout(task, config.points)
    hand = next(iter(layout.hands), 0)
    loose = [i for i, e in enumerate(layout) if e.loose]
    seen: dict[str, Any] = {
        "features_extractor_class": EntityFeatures,
        "features_extractor_kwargs": {"hand": hand, "objects": loose, "goal_size": task.goal_size},
    }
    if config.observation == "points":
        counts = [e.points for e in layout]
        seen = {
            "features_extractor_class": PointFeatures,
            "features_extractor_kwargs": {"counts": counts, "hand": hand},
        }
    first = {"log_std_init": float(np.log(config.exploration))} if config.algorithm == "ppo" else {}
    return {**seen, **first, "net_arch": [config.width, config.width], "activation_fn": nn.ELU}


def save_agent(folder: Path, policy: BasePolicy, task: Task, config: AgentConfig, told: dict[str, Any]) -> None:
    """Write what acts of a policy as safetensors, and what it is.

    Args:
        folder: to write to; its files are replaced.
        policy: of stable-baselines3.
        task: that it acts in.
        config: of its training.
        told: what its training was, of JSON's types.
    """
    facts = _Facts(task.name, config.algorithm, config.observation, config.points, config.width, task.action_size)
    training = {"config": asdict(config), **told}
    save_weights(folder, _actor(policy), {"format": FORMAT, "schema": SCHEMA, **asdict(facts), "training": training})


def load_agent(folder: str | Path, task: str | None = None) -> LearnedPolicy:
    """A policy that :func:`save_agent` wrote.

    Args:
        folder: of it.
        task: that it must be of; None takes any.

    Raises:
        CheckpointError: missing, damaged or foreign files, of another task, or of actions of another size.
        UnknownNameError: its task is not registered.
    """
    folder = Path(folder)
    found = read_description(folder, FORMAT, SCHEMA, _Facts)
    if task is not None and found["task"] != task:
        raise CheckpointError(f"{folder} is a policy of {found['task']}; expected one of {task}")
    known = get_task(found["task"])
    if found["action_size"] != known.action_size:
        raise CheckpointError(
            f"{folder} acts with {found['action_size']} components; {known.name} takes {known.action_size}"
        )
    if found["algorithm"] not in ALGORITHMS:
        raise CheckpointError(f"{folder} was trained by {found['algorithm']!r}; expected {' or '.join(ALGORITHMS)}")
    try:
        kept = {key: found[key] for key in ("algorithm", "observation", "points", "width")}
        config = AgentConfig(**kept)
        layout = _layout(known, config.points)
    except PwmGymError as error:
        raise CheckpointError(f"{folder}: {error}") from error
    space = OBSERVATIONS[config.observation].space(layout, known.goal_size)
    policy = rebuild(folder, {"width": config.width}, lambda: _build(known, config, space))
    load_weights(_actor(policy), folder)
    return LearnedPolicy(policy, layout, config.observation)


def _build(task: Task, config: AgentConfig, space: gym.Space[Any]) -> BasePolicy:
    """An untrained policy of the same shape."""
    kind: Any = algorithm_class(config.algorithm).policy_aliases[policy_name(config)]
    return kind(space, action_space(task.action_size), lambda _: 0.0, **policy_settings(task, config))


def _actor(policy: Any) -> nn.Module:
    """What acts, without the critics."""
    if isinstance(policy, SACPolicy):
        return policy.actor
    parts = {"features": policy.pi_features_extractor, "hidden": policy.mlp_extractor.policy_net}
    return nn.ModuleDict({**parts, "action": policy.action_net})


def policy_name(config: AgentConfig) -> str:
    """Stable-baselines3's name of the policy."""
    return "MlpPolicy" if config.observation == "poses" else "MultiInputPolicy"


def _layout(task: Task, points: int) -> Layout:
    return task.layout.resize(points) if points else task.layout


class LearnedPolicy:
    """Acts on the entities of a state, without noise.

    Args:
        policy: of stable-baselines3.
        layout: entities of the scenes.
        observation: "poses" or "points": what it reads.
    """

    def __init__(self, policy: BasePolicy, layout: Layout, observation: str) -> None:
        self.policy, self.layout, self._shown = policy, layout, OBSERVATIONS[observation]

    @torch.no_grad()
    def act(self, state: RigidState, goal: Tensor) -> Tensor:
        """Actions (B, A) in [-1, 1] in states (B,) for goals (B, G).

        Raises:
            PwmGymError: a scene of other entities.
        """
        check_entities(state, self.layout)
        if state.layout != self.layout:
            state = state.coarsen(self.layout)
        seen = self._shown.observe(state, goal)
        shown = {k: v.cpu().numpy() for k, v in seen.items()} if isinstance(seen, dict) else seen.cpu().numpy()
        actions, _ = self.policy.predict(shown, deterministic=True)
        return torch.as_tensor(actions)
