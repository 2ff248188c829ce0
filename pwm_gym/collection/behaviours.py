"""Who acts while data is collected."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np

from pwm_gym.planning import Agent
from pwm_gym.scene import Scene
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Expert, Task

__all__ = ["Behaviour", "Demonstration", "OnPolicy", "Practice"]


class Behaviour(Protocol):
    """Acts for one episode."""

    kind: str
    switch: int

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,) in [-1, 1]."""

    def done(self, success: bool) -> bool:
        """Whether the episode ends here."""


class Demonstration:
    """The expert; with probability ``randomise`` uniformly random from a uniformly drawn step (paper, appendix).

    Args:
        task: the task.
        rng: source of all its randomness.
        length: steps of an episode that switches; the switch is drawn within them.
        randomise: probability of a switch.
        linger: steps that the expert goes on after success.
    """

    def __init__(
        self, task: Task, rng: np.random.Generator, length: int = 66, randomise: float = 0.2, linger: int = 8
    ) -> None:
        self._rng, self._task, self._linger = rng, task, linger
        self._expert, self._length = task.expert(rng), length
        self.switch = int(rng.integers(0, length)) if rng.random() < randomise else -1
        self.kind = "expert" if self.switch < 0 else "randomised"
        self._step = 0

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,)."""
        self._step += 1
        if 0 <= self.switch < self._step:
            return _uniform(self._rng, self._task.action_size)
        return self._expert.act(simulator.poses(), simulator.goal())

    def done(self, success: bool) -> bool:
        """Whether an expert's episode has lingered long enough, or a random one is as long as a demonstration."""
        if self.switch >= 0:
            return self._step >= self._length
        self._linger -= success
        return self._linger < 0


class Practice:
    """Segments of 6 to 60 steps that show what demonstrations seldom do: shut fingers on the object, pushes, tosses."""

    kind = "practice"
    switch = -1

    def __init__(self, task: Task, rng: np.random.Generator) -> None:
        self._task, self._rng = task, rng
        self._left = 0
        self._segment: Callable[[Simulator], np.ndarray] = self._idle()
        self._gripper = 1.0

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,)."""
        if self._left == 0:
            self._left = int(self._rng.integers(6, 41))
            makers = [self._resume, self._waypoint, self._pinch, self._toss, self._idle, self._random, self._wander]
            self._segment = makers[self._rng.choice(len(makers), p=[0.15, 0.15, 0.15, 0.3, 0.08, 0.07, 0.1])]()
        self._left -= 1
        action = self._segment(simulator)
        self._gripper = float(action[-1])
        return action

    def done(self, success: bool) -> bool:
        """Never: it runs to the time limit."""
        return False

    def _resume(self) -> Callable[[Simulator], np.ndarray]:
        """The expert, from wherever the scene is."""
        expert: Expert = self._task.expert(self._rng)
        pace = self._rng.uniform(1.0, 3.0)

        def act(simulator: Simulator) -> np.ndarray:
            action = expert.act(simulator.poses(), simulator.goal())
            action[:3] = np.clip(pace * action[:3], -1, 1)
            return action

        return act

    def _waypoint(self) -> Callable[[Simulator], np.ndarray]:
        """Straight to a point around the object, at any speed, the gripper open, shut or as it is."""
        rng, task = self._rng, self._task
        offset = rng.normal(0.0, [0.05, 0.05, 0.0]) + [0.0, 0.0, rng.uniform(-0.01, 0.12)]
        gripper = float(rng.choice([1.0, -1.0, self._gripper, rng.uniform(-1, 1)]))
        speed, turn = rng.uniform(0.01, 0.1), rng.normal(0.0, 0.03, 3) * [0.3, 0.3, 1.0]
        target: list[np.ndarray] = []

        def act(simulator: Simulator) -> np.ndarray:
            poses = simulator.poses()
            if not target:
                target.append(poses[task.layout.index(task.objects[0]), :3] + offset)
            reach = target[0] - task.robot.tool(poses)[:3]
            step = reach * min(1.0, speed / max(float(np.linalg.norm(reach)), 1e-9))
            return task.robot.action(step, turn, gripper)

        return act

    def _pinch(self) -> Callable[[Simulator], np.ndarray]:
        """Down on the object with open fingers, off its centre and askew, then shut; half of the time, up again."""
        rng, task = self._rng, self._task
        offset, twist = rng.normal(0.0, [0.015, 0.015, 0.008]), rng.normal(0.0, 0.02)
        speed, lift = rng.uniform(0.015, 0.06), float(rng.choice([0.0, 0.03]))
        patience, hold = int(rng.integers(10, 25)), int(rng.integers(2, 10))
        self._left = patience + hold + 10

        def act(simulator: Simulator) -> np.ndarray:
            nonlocal patience, hold
            poses = simulator.poses()
            reach = poses[task.layout.index(task.objects[0]), :3] + offset - task.robot.tool(poses)[:3]
            if patience <= 0 or np.linalg.norm(reach) < 0.006:
                patience, hold = 0, hold - 1
                return task.robot.action(np.array([0.0, 0.0, lift * (hold < 0)]), np.zeros(3), -1.0)
            patience -= 1
            if np.linalg.norm(reach[:2]) > 0.02:
                reach = reach + [0.0, 0.0, 0.06]
            step = reach * min(1.0, speed / max(float(np.linalg.norm(reach)), 1e-9))
            return task.robot.action(step, np.array([0.0, 0.0, twist]), 1.0)

        return act

    def _toss(self) -> Callable[[Simulator], np.ndarray]:
        """The expert for up to 35 steps, which often holds the object by then, and random actions after them."""
        expert, throw = self._resume(), self._random()
        grip, wild = int(self._rng.integers(3, 36)), int(self._rng.integers(10, 26))
        self._left = grip + wild

        def act(simulator: Simulator) -> np.ndarray:
            nonlocal grip
            grip -= 1
            return expert(simulator) if grip >= 0 else throw(simulator)

        return act

    def _idle(self) -> Callable[[Simulator], np.ndarray]:
        """The arm is commanded nowhere; the gripper keeps its command, or the whole action is zero."""
        zero = self._rng.random() < 0.4
        return lambda _: self._task.robot.action(np.zeros(3), np.zeros(3), 0.0 if zero else self._gripper)

    def _random(self) -> Callable[[Simulator], np.ndarray]:
        """Uniformly random actions."""
        return lambda _: _uniform(self._rng, self._task.action_size)

    def _wander(self) -> Callable[[Simulator], np.ndarray]:
        """Time-correlated noise, as a sampling planner's."""
        rng, size = self._rng, self._task.action_size
        scale, keep = rng.uniform(0.1, 0.8), rng.uniform(0.5, 0.95)
        spread = np.full(size, scale)
        spread[3:-1] *= rng.uniform(0.0, 1.0)
        mean = np.zeros(size)
        mean[-1] = self._gripper
        noise = rng.normal(0.0, spread)

        def act(_: Simulator) -> np.ndarray:
            nonlocal noise
            noise = keep * noise + np.sqrt(1 - keep**2) * rng.normal(0.0, spread)
            return np.clip(mean + noise, -1, 1).astype(np.float32)

        return act


class OnPolicy:
    """A planner's own run in the simulator: what the model's mistakes lead to.

    Args:
        task: the task.
        agent: plans.
        clouds: canonical points (N, 3) of the data set.
        seed: of the planner's noise.
        linger: steps that it goes on after success.
    """

    kind = "on_policy"
    switch = -1

    def __init__(self, task: Task, agent: Agent, clouds: np.ndarray, seed: int, linger: int = 5) -> None:
        self._task, self._agent, self._clouds, self._linger = task, agent, clouds, linger
        self._seen: deque[np.ndarray] = deque(maxlen=3)  # poses, newest first
        self._last: np.ndarray | None = None
        agent.reset(seed)

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,)."""
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
        )
        self._last = self._agent.act(scene).astype(np.float32)
        return self._last

    def done(self, success: bool) -> bool:
        """Whether it has lingered long enough after success."""
        self._linger -= success
        return self._linger < 0


def _uniform(rng: np.random.Generator, size: int) -> np.ndarray:
    return rng.uniform(-1.0, 1.0, size).astype(np.float32)
