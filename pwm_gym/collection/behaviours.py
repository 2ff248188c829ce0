"""Who acts while data is collected."""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np

from pwm_gym.collection.practice import Practice, uniform
from pwm_gym.collection.starts import LONG, mirror, run_ahead
from pwm_gym.planning import Agent
from pwm_gym.scene import Scene, sample_clouds
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

__all__ = ["Behaviour", "Demonstration", "Mirrored", "OnPolicy", "Practice"]

_LASTING = 0.9  # correlation of jitter from one step to the next
_WHERE, _NOISE = 2, 3  # of the generators that draw where an on-policy episode starts, and its jitter


class Behaviour(Protocol):
    """Acts for one episode."""

    kind: str
    switch: int

    def start(self, simulator: Simulator) -> None:
        """Called once after the simulator's reset, before the episode's first pose is read; may change the scene."""

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,) in [-1, 1]."""

    def done(self, success: bool) -> bool:
        """Whether the episode ends here."""


class Mirrored:
    """Another behaviour in the mirrored scene (:func:`~pwm_gym.collection.starts.mirror`).

    Args:
        task: the task.
        behaviour: who acts.
    """

    def __init__(self, task: Task, behaviour: Behaviour) -> None:
        self._task, self._behaviour = task, behaviour
        self.kind, self.switch = behaviour.kind, behaviour.switch

    def start(self, simulator: Simulator) -> None:
        """Mirror the scene, and start in it."""
        mirror(simulator, self._task)
        self._behaviour.start(simulator)

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,)."""
        return self._behaviour.act(simulator)

    def done(self, success: bool) -> bool:
        """Whether the behaviour's episode ends here."""
        return self._behaviour.done(success)


class Jitter:
    """Noise on what actions ask of arms, which lasts from step to step (Laskey et al., DART, 2017).

    Args:
        task: the task.
        rng: its source.
        largest: each episode's standard deviation is drawn up to it, in action units.
    """

    def __init__(self, task: Task, rng: np.random.Generator, largest: float) -> None:
        moves = np.array([kind not in ("gripper", "finger") for kind in task.control.kinds])
        self._rng, self._size = rng, rng.uniform(0.0, largest) * moves if largest else None
        self._noise = np.zeros(task.action_size)

    def __call__(self, action: np.ndarray) -> np.ndarray:
        """The action (A,) with noise."""
        if self._size is None:
            return action
        fresh = self._rng.standard_normal(len(self._noise))
        self._noise = _LASTING * self._noise + (1.0 - _LASTING**2) ** 0.5 * fresh
        return np.clip(action + self._size * self._noise, -1.0, 1.0).astype(action.dtype)


class Demonstration:
    """The expert; with probability ``randomise`` uniformly random from a uniformly drawn step (paper, appendix).

    Args:
        task: the task.
        rng: source of all its randomness.
        length: steps of an episode that switches, within which the switch is drawn; None: the expert's mean length.
        randomise: probability of a switch.
        linger: steps that the expert goes on after success.
        jitter: largest, as of :class:`Jitter`. The expert puts right what it does.
    """

    def __init__(
        self,
        task: Task,
        rng: np.random.Generator,
        length: int | None = None,
        randomise: float = 0.2,
        linger: int = 8,
        jitter: float = 0.0,
    ) -> None:
        self._rng, self._task, self._linger = rng, task, linger
        self._expert = task.expert(rng)
        self._length = task.expert_steps if length is None else length
        self.switch = int(rng.integers(0, self._length)) if rng.random() < randomise else -1
        self.kind = "expert" if self.switch < 0 else "randomised"
        self._step = 0
        self._jitter = Jitter(task, rng, jitter)

    def start(self, simulator: Simulator) -> None:
        """Nothing: demonstrations start where the task says."""

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,)."""
        self._step += 1
        if 0 <= self.switch < self._step:
            return uniform(self._rng, self._task.action_size)
        return self._jitter(self._expert.act(simulator.poses(), simulator.goal(), simulator.assets()))

    def done(self, success: bool) -> bool:
        """Whether an expert's episode has lingered long enough, or a random one is as long as a demonstration."""
        if self.switch >= 0:
            return self._step >= self._length
        self._linger -= success
        return self._linger < 0


class OnPolicy:
    """A planner's or a policy's own run in the simulator: what the model's mistakes lead to.

    Args:
        task: the task.
        agent: acts.
        seed: of the planner's noise, of jitter, and of where it starts.
        linger: steps that it goes on after success.
        underway: of long tasks, probability that it starts where the expert is after a number of steps.
        jitter: largest, as of :class:`Jitter`.
    """

    kind = "on_policy"
    switch = -1

    def __init__(
        self, task: Task, agent: Agent, seed: int, linger: int = 5, underway: float = 0.85, jitter: float = 0.0
    ) -> None:
        self._task, self._agent, self._linger = task, agent, linger
        self._rng = np.random.default_rng([seed, _WHERE])
        self._jitter = Jitter(task, np.random.default_rng([seed, _NOISE]), jitter)
        self._underway = underway if task.expert_steps >= LONG else 0.0
        self._clouds: np.ndarray | None = None
        self._seen: deque[np.ndarray] = deque(maxlen=3)  # poses, newest first
        self._last: np.ndarray | None = None
        agent.reset(seed)

    def start(self, simulator: Simulator) -> None:
        """Sample the clouds of the episode's objects, and go to where it starts."""
        self._clouds = sample_clouds(simulator.meshes(), self._task.layout, self._task.cloud_seed)
        if self._rng.random() < self._underway:
            self._last = run_ahead(simulator, self._task, self._rng)

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,)."""
        assert self._clouds is not None, "start() first"
        self._seen.appendleft(simulator.poses())
        poses = np.stack([self._seen[min(k, len(self._seen) - 1)] for k in range(3)])
        scene = Scene(
            self._task.name,
            self._task.layout,
            self._clouds,
            poses,
            simulator.goal(),
            simulator.joints(),
            last_action=self._last,
            assets=simulator.assets(),
        )
        self._last = self._jitter(self._agent.act(scene).astype(np.float32))
        return self._last

    def done(self, success: bool) -> bool:
        """Whether it has lingered long enough after success."""
        self._linger -= success
        return self._linger < 0
