"""What can be ranked: trained policies, experts with noise, planners, and chance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from pwm_gym.agents.policy import FORMAT, load_agent
from pwm_gym.dynamics import load_checkpoint, resolve
from pwm_gym.errors import CheckpointError, PwmGymError, UnknownNameError
from pwm_gym.planning import Agent, get_planner_config
from pwm_gym.policies import ActsOnPoses, PolicyAgent, load_policy
from pwm_gym.scene import RigidState, Scene
from pwm_gym.scene.se3 import pose7_from_matrix
from pwm_gym.schema import read_json
from pwm_gym.tasks import Task

__all__ = ["Begins", "contestant", "contestant_agent", "training_of"]


@runtime_checkable
class Begins(Protocol):
    """A policy with randomness or memory of its own, which is told when episodes begin."""

    def begin(self, episodes: Sequence[int]) -> None:
        """The next states are of these episodes, row by row; the same numbers mean the same randomness."""


def contestant(spec: str, task: Task) -> ActsOnPoses:
    """A policy of a task.

    Args:
        spec: a folder of ``pwm-gym train-agent``; "expert:0.3", the scripted expert with noise of this standard
            deviation on its actions; "mppi:64", the planner with so many samples, in the shipped model or, as
            "mppi:64@FOLDER", in another checkpoint's; or "random".
        task: that it is to act in.

    Raises:
        UnknownNameError: none of these, or a checkpoint that there is not.
        PwmGymError: a number that cannot be.
        CheckpointError: a folder of another task, or of none.
    """
    kind, _, value = spec.partition(":")
    if kind in _KINDS and not Path(spec).is_dir():
        return _KINDS[kind](value, task)
    if not Path(spec).is_dir():
        known = ", ".join(_KINDS)
        raise UnknownNameError(f"unknown policy {spec!r}; expected a folder of train-agent, or one of {known}")
    described = read_json(Path(spec) / "config.json", dict, CheckpointError)
    if described.get("format") == FORMAT:
        return load_agent(spec, task.name)
    if described.get("task") != task.name:
        raise CheckpointError(f"{spec} is a policy of {described.get('task')}; expected one of {task.name}")
    return load_policy(spec)


def contestant_agent(spec: str, task: Task) -> Agent:
    """The same policy as something that acts on scenes, whose episodes are told apart by their seeds."""
    return _Contestant(contestant(spec, task), task.name)


def training_of(spec: str) -> dict[str, Any] | None:
    """Seconds and environment steps that an agent's training took; None of what is no agent's folder."""
    if not Path(spec).is_dir():
        return None
    described = read_json(Path(spec) / "config.json", dict, CheckpointError)
    if described.get("format") != FORMAT:
        return None
    return {key: described["training"][key] for key in ("seconds", "steps")}


class _Contestant(PolicyAgent):
    """Tells its policy when an episode begins."""

    def reset(self, seed: int) -> None:
        """Begin the episode of ``seed``."""
        super().reset(seed)
        if isinstance(self.policy, Begins):
            self.policy.begin([seed])


class _Random:
    """Uniform actions."""

    def __init__(self, value: str, task: Task) -> None:
        if value:
            raise PwmGymError(f"random:{value}; expected random alone")
        self._size = task.action_size
        self._generators: list[np.random.Generator] = []

    def begin(self, episodes: Sequence[int]) -> None:
        """Seed each row by its episode."""
        self._generators = [np.random.default_rng((7, k)) for k in episodes]

    def act(self, state: RigidState, goal: Tensor) -> Tensor:
        """Actions (B, A)."""
        return torch.as_tensor(np.stack([g.uniform(-1, 1, self._size) for g in self._generators]), dtype=torch.float32)


class _Expert:
    """The scripted expert; noise of a standard deviation is added to its actions."""

    def __init__(self, value: str, task: Task) -> None:
        self._task, self._noise = task, _number(f"expert:{value}", value or "0", 0.0)
        self._generators: list[np.random.Generator] = []

    def begin(self, episodes: Sequence[int]) -> None:
        """An expert of its own for each row."""
        self._generators = [np.random.default_rng((11, k)) for k in episodes]
        self._experts = [self._task.expert(g) for g in self._generators]

    def act(self, state: RigidState, goal: Tensor) -> Tensor:
        """Actions (B, A)."""
        poses, goals = pose7_from_matrix(state.poses().double().cpu()).numpy(), goal.cpu().numpy()
        actions = [e.act(p, g) for e, p, g in zip(self._experts, poses, goals, strict=True)]
        noise = [g.normal(0.0, 1.0, self._task.action_size) for g in self._generators]
        noisy = np.stack(actions) + self._noise * np.stack(noise)
        return torch.as_tensor(noisy.clip(-1.0, 1.0), dtype=torch.float32)


class _Planned:
    """The task's planner with a number of samples, in its shipped model or another checkpoint's."""

    def __init__(self, value: str, task: Task) -> None:
        count, _, checkpoint = value.partition("@")
        samples = int(_number(f"mppi:{count}", count, 1.0))
        config = get_planner_config(task.planner).resize(samples)
        self._task = task
        self._agent = Agent(load_checkpoint(resolve(checkpoint or "default", task.name)).model, task.name, config)

    def begin(self, episodes: Sequence[int]) -> None:
        """Forget the last plan."""
        self._agent.reset(episodes[0])

    def act(self, state: RigidState, goal: Tensor) -> Tensor:
        """Actions (B, A)."""
        frames, goals = pose7_from_matrix(state.frames.double().cpu()).numpy(), goal.cpu().numpy()
        clouds = state.clouds.cpu().numpy()
        rows = zip(clouds, frames, goals, strict=True)
        scenes = [Scene(self._task.name, state.layout, cloud, poses, aim) for cloud, poses, aim in rows]
        return torch.as_tensor(self._agent.act(scenes), dtype=torch.float32)


_KINDS: Mapping[str, Callable[[str, Task], ActsOnPoses]] = MappingProxyType(
    {"random": _Random, "expert": _Expert, "mppi": _Planned}
)


def _number(spec: str, value: str, least: float) -> float:
    """The number in a policy's name."""
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not least <= number < math.inf:
        raise PwmGymError(f"{spec!r} names no policy; expected a number of at least {least:g} after the colon")
    return number
