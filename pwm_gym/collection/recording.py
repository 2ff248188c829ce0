"""One episode while it is recorded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pwm_gym.collection.behaviours import Behaviour
from pwm_gym.data.episodes import KINDS, Episode
from pwm_gym.sim import SimOutcome, Simulator

__all__ = ["Recording", "record_episode"]

_SHORTEST = 3  # steps, so that an episode has both velocities


class Recording:
    """The episode of ``seed``, which the simulator has just been reset to.

    Args:
        simulator: shows the episode's start; ``behaviour`` may change that first.
        seed: of the episode.
        behaviour: acts.
        limit: steps at most.
    """

    def __init__(self, simulator: Simulator, seed: int, behaviour: Behaviour, limit: int) -> None:
        behaviour.start(simulator)
        self._seed, self._behaviour, self._limit = seed, behaviour, limit
        self._goal, self._assets = simulator.goal(), simulator.assets()  # a goal may move later
        self._poses, self._joints = [simulator.poses()], [simulator.joints()]
        self._actions: list[np.ndarray] = []
        self._outcomes: list[SimOutcome] = []
        self.done = limit < 1
        """Whether it ends here."""

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,) in [-1, 1]."""
        self._actions.append(self._behaviour.act(simulator))
        return self._actions[-1]

    def add(self, simulator: Simulator, outcome: SimOutcome) -> None:
        """What came of the last action."""
        self._outcomes.append(outcome)
        self._poses.append(simulator.poses())
        self._joints.append(simulator.joints())
        steps = len(self._outcomes)
        ended = self._behaviour.done(outcome.success) and steps >= _SHORTEST
        self.done = ended or steps >= self._limit

    def episode(self) -> Episode:
        """What was recorded."""
        return Episode(
            poses=np.asarray(self._poses, np.float32),
            joints=np.asarray(self._joints, np.float32),
            actions=np.asarray(self._actions, np.float32),
            rewards=np.array([o.reward for o in self._outcomes], np.float32),
            success=np.array([o.success for o in self._outcomes]),
            grasped=np.array([o.grasped for o in self._outcomes]),
            goal=self._goal,
            kind=KINDS.index(self._behaviour.kind),
            seed=self._seed,
            switch=self._behaviour.switch,
            assets=self._assets,
        )


def record_episode(simulator: Simulator, seed: int, make: Callable[[int], Behaviour], limit: int) -> Episode:
    """One episode of at most ``limit`` steps from ``seed``; at least three, so that it has both velocities."""
    simulator.reset(seed)
    recording = Recording(simulator, seed, make(seed), limit)
    while not recording.done:
        action = recording.act(simulator)
        recording.add(simulator, simulator.step(action))
    return recording.episode()
