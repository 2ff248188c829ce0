"""Practice: what demonstrations seldom show. Segments of many kinds follow each other at random."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from pwm_gym.collection.extents import Extents
from pwm_gym.collection.starts import LONG, perturb, run_ahead
from pwm_gym.sim import Simulator
from pwm_gym.skills import drive
from pwm_gym.tasks import Expert, Task

__all__ = ["PRACTICE_STEPS", "Practice", "uniform"]

_TIP = 0.012  # metres over the ground below which the tool does not go: the finger tips are 1 cm under it
_SAFE = 0.10  # metres over an object's top at which the tool moves about without touching it
_NEAR = 0.008  # metres from a target at which it is reached
_SHUT, _OPEN = -1.0, 1.0
PRACTICE_STEPS = 80
"""Length of an episode."""

Actions = Iterator[np.ndarray]


@dataclass(frozen=True)
class _Stroke:
    """A straight push through an object."""

    start: np.ndarray
    end: np.ndarray
    """Tool positions (3,), metres."""
    speed: float
    """Translation asked for in a step, metres."""


class Practice:
    """Segments of up to 60 steps: shut fingers on objects, pushes, drags, drops, tosses, noise.

    Args:
        task: the task.
        rng: source of all its randomness.
        unusual: probability that the episode starts from a scene that no episode of the task starts from.
        underway: of long tasks, probability that it starts where the expert is after a number of steps, drawn up to a
            demonstration's mean length: no segment gets as far.
    """

    kind = "practice"
    switch = -1

    def __init__(self, task: Task, rng: np.random.Generator, unusual: float = 0.15, underway: float = 0.85) -> None:
        self._task, self._rng = task, rng
        self._unusual = unusual
        self._underway = underway if task.expert_steps >= LONG else 0.0
        self._control = task.control
        self._segment: Actions = iter(())
        self._last = np.array(self._control.rest(), np.float32)
        self._simulator: Simulator
        self._extents: Extents | None = None
        self._makers, self._shares = self._segments()

    def _segments(self) -> tuple[list[Callable[[], Actions]], np.ndarray]:
        """Makers of segments, and how often each is chosen."""
        shares: dict[Callable[[], Actions], float] = {
            self._resume: 0.12,
            self._toss: 0.20,
            self._idle: 0.07,
            self._random: 0.06,
            self._wander: 0.09,
        }
        if self._task.robot.tool is not None and self._task.robot.action is not None:
            shares[self._waypoint] = 0.09
            if self._task.objects:
                shares |= {self._pinch: 0.18, self._push: 0.13, self._drop: 0.06, self._drag: 0.03}
            if len(self._task.objects) > 1:
                shares[self._ram] = 0.06
        weights = np.array([*shares.values()])
        return list(shares), weights / weights.sum()

    def start(self, simulator: Simulator) -> None:
        """Change the scene of a fresh episode, sometimes."""
        if self._underway and self._rng.random() < self._underway:
            last = run_ahead(simulator, self._task, self._rng)
            self._last = self._last if last is None else last
        elif self._rng.random() < self._unusual:
            perturb(simulator, self._task.layout, self._rng, Extents(simulator), self._task.robot.tool)

    def act(self, simulator: Simulator) -> np.ndarray:
        """Next action (A,)."""
        self._simulator = simulator
        action = next(self._segment, None)
        while action is None:
            self._segment = self._makers[self._rng.choice(len(self._makers), p=self._shares)]()
            action = next(self._segment, None)
        self._last = action
        return action

    def done(self, success: bool) -> bool:
        """Never: it runs to the time limit."""
        return False

    # What the scene shows -----------------------------------------------------------------------------------------

    def _pose(self, name: str) -> np.ndarray:
        return self._simulator.poses()[self._task.layout.index(name)]

    def _tool(self) -> np.ndarray:
        assert self._task.robot.tool is not None
        return self._task.robot.tool(self._simulator.poses())[:3]

    def _boxes(self) -> Extents:
        if self._extents is None:
            self._extents = Extents(self._simulator)
        return self._extents

    def _any_object(self) -> str:
        return str(self._rng.choice(self._task.objects))

    def _any_loose(self) -> str:
        """Of what could be lifted; any object where there is none."""
        layout = self._task.layout
        return str(self._rng.choice([layout.names[k] for k in layout.loose] or self._task.objects))

    @property
    def _gripper(self) -> float:
        """Last command to the (first) gripper; open where there is none."""
        channels = self._control.of_kind("gripper")
        return float(self._last[channels[0].start]) if channels else _OPEN

    # Motions ------------------------------------------------------------------------------------------------------

    def _move(self, offset: np.ndarray, speed: float, gripper: float, turn: float = 0.0) -> np.ndarray:
        return drive(self._task.robot, offset, speed, gripper, turn)

    def _go(self, target: np.ndarray, speed: float, gripper: float, turn: float = 0.0, steps: int = 25) -> Actions:
        """Straight to a tool position (3,), for at most ``steps`` steps."""
        for _ in range(steps):
            offset = target - self._tool()
            if np.linalg.norm(offset) < _NEAR:
                return
            yield self._move(offset, speed, gripper, turn)

    def _hold_still(self, steps: int, gripper: float) -> Actions:
        for _ in range(steps):
            yield self._move(np.zeros(3), 1.0, gripper)

    def _grip(self) -> Actions:
        """The expert for up to 35 steps, which often holds an object by then."""
        return islice(self._follow_expert(), int(self._rng.integers(3, 36)))

    def _follow_expert(self) -> Actions:
        """The expert, up to three times as fast."""
        expert: Expert = self._task.expert(self._rng)
        pace = self._rng.uniform(1.0, 3.0)
        while True:
            simulator = self._simulator
            action = np.array(expert.act(simulator.poses(), simulator.goal(), simulator.assets()), np.float32)
            for channel in self._control.of_kind("translation"):
                action[channel.slice] = np.clip(pace * action[channel.slice], -1, 1)
            yield action

    # Segments -----------------------------------------------------------------------------------------------------

    def _some(self) -> int:
        """Length of a segment that has no end of its own."""
        return int(self._rng.integers(6, 41))

    def _resume(self) -> Actions:
        """The expert, from wherever the scene is."""
        return islice(self._follow_expert(), self._some())

    def _waypoint(self) -> Actions:
        """Straight to a point around an object or the tool, at any speed, the gripper open, shut or as it is."""
        rng = self._rng
        offset = rng.normal(0.0, [0.05, 0.05, 0.0]) + [0.0, 0.0, rng.uniform(-0.01, 0.12)]
        gripper = float(rng.choice([_OPEN, _SHUT, self._gripper, rng.uniform(-1, 1)]))
        speed, turn = rng.uniform(0.01, 0.1), rng.normal(0.0, 0.03, 3) * [0.3, 0.3, 1.0]
        target = (self._pose(self._any_object())[:3] if self._task.objects else self._tool()) + offset
        assert self._task.robot.action is not None
        for _ in range(self._some()):
            reach = target - self._tool()
            step = reach * min(1.0, speed / max(float(np.linalg.norm(reach)), 1e-9))
            yield self._task.robot.action(step, turn, gripper)

    def _pinch(self) -> Actions:
        """Down on an object with open fingers, off its centre and misaligned, then shut; half of the time, up again."""
        rng = self._rng
        yield from self._shut_on(self._any_loose())
        lift = float(rng.choice([0.0, 0.03]))
        yield from (self._move(np.array([0.0, 0.0, lift]), 1.0, _SHUT) for _ in range(10))

    def _shut_on(self, name: str) -> Actions:
        rng = self._rng
        offset, turn = rng.normal(0.0, [0.015, 0.015, 0.008]), rng.normal(0.0, 0.02)
        speed = rng.uniform(0.015, 0.06)
        for _ in range(int(rng.integers(10, 25))):
            reach = self._pose(name)[:3] + offset - self._tool()
            if np.linalg.norm(reach) < 0.006:
                break
            if np.linalg.norm(reach[:2]) > 0.02:
                reach = reach + [0.0, 0.0, 0.06]
            yield self._move(reach, speed, _OPEN, turn)
        yield from self._hold_still(int(rng.integers(2, 10)), _SHUT)

    def _drag(self) -> Actions:
        """Shut on an object and pull it sideways where it is: away from under what stands on it, too."""
        rng = self._rng
        yield from self._shut_on(self._any_loose())
        way = rng.uniform(0.05, 0.2) * self._direction(rng.uniform(-np.pi, np.pi))
        yield from self._go(self._tool() + way, rng.uniform(0.01, 0.1), _SHUT, steps=20)

    def _push(self) -> Actions:
        """The tool lowered beside an object, then straight through it: at any height, speed, direction, off-centre.

        A high stroke topples what stands; with several objects, half of the strokes push one into another.
        """
        rng = self._rng
        name = self._any_object()
        stroke = self._stroke(name)
        gripper = float(rng.choice([_SHUT, _SHUT, _OPEN, self._gripper]))
        turn = float(rng.choice([0.0, rng.normal(0.0, 0.03)]))
        above = self._boxes().height(name, self._pose(name))[1] + _SAFE
        travel = rng.uniform(0.06, 0.1)
        tool = self._tool()
        if np.linalg.norm(stroke.start[:2] - tool[:2]) > 0.03:  # over the object, not through it
            yield from self._go(np.r_[tool[:2], max(above, tool[2])], travel, gripper, steps=10)
            yield from self._go(np.r_[stroke.start[:2], above], travel, gripper, turn, steps=15)
        yield from self._go(stroke.start, travel, gripper, turn, steps=12)
        yield from self._go(stroke.end, stroke.speed, gripper, turn, steps=25)

    def _stroke(self, name: str) -> _Stroke:
        rng = self._rng
        pose = self._pose(name)
        angle = rng.uniform(-np.pi, np.pi)
        others = [other for other in self._task.objects if other != name]
        if others and rng.random() < 0.5:
            way = self._pose(str(rng.choice(others)))[:2] - pose[:2]
            angle = np.arctan2(way[1], way[0]) + rng.normal(0.0, 0.2)
        direction = self._direction(angle)
        reach = self._boxes().reach(name, pose, -direction)
        sideways = rng.normal(0.0, 0.4 * reach) * self._direction(angle + np.pi / 2)
        low, high = self._boxes().height(name, pose)
        height = max(low + rng.uniform(0.0, 1.0) * (high - low), low + _TIP)
        middle = np.r_[pose[:2], height] + sideways
        start = middle - (reach + rng.uniform(0.03, 0.06)) * direction
        return _Stroke(start, middle + rng.uniform(-0.02, 0.15) * direction, rng.uniform(0.01, 0.1))

    @staticmethod
    def _direction(angle: float) -> np.ndarray:
        return np.array([np.cos(angle), np.sin(angle), 0.0])

    def _ram(self) -> Actions:
        """What the expert holds, pushed into another object or set on it and let go."""
        rng = self._rng
        yield from self._grip()
        held = min(self._task.objects, key=lambda n: float(np.linalg.norm(self._pose(n)[:3] - self._tool())))
        other = str(rng.choice([n for n in self._task.objects if n != held]))
        pose = self._pose(other)
        target = pose[:3] + rng.normal(0.0, 0.01, 3)
        target[2] = rng.uniform(*self._boxes().height(other, pose)) + rng.uniform(0.0, 0.04)
        beyond = target + rng.uniform(0.0, 0.6) * (target - self._tool()) * [1.0, 1.0, 0.0]
        yield from self._go(beyond, rng.uniform(0.02, 0.1), _SHUT)
        yield from self._hold_still(int(rng.integers(0, 8)), float(rng.choice([_OPEN, _SHUT])))

    def _drop(self) -> Actions:
        """The expert for a while, a lift with some drift, and open fingers in mid-air."""
        rng = self._rng
        yield from self._grip()
        lift = rng.normal(0.0, [0.02, 0.02, 0.0]) + [0.0, 0.0, rng.uniform(0.01, 0.06)]
        for _ in range(int(rng.integers(2, 9))):
            yield self._move(lift, 0.1, _SHUT)
        drift = float(rng.choice([0.0, 1.0]))
        for _ in range(int(rng.integers(6, 14))):
            yield self._move(drift * lift, 0.1, _OPEN)

    def _toss(self) -> Actions:
        """The expert for a while, then random actions."""
        yield from self._grip()
        yield from islice(self._noise(), int(self._rng.integers(10, 26)))

    def _idle(self) -> Actions:
        """Nothing is asked for; the gripper keeps its command, or the whole action is zero."""
        action = self._rest()
        if self._rng.random() < 0.4:
            action = np.where(self._absolute(), self._last, 0.0).astype(np.float32)
        for _ in range(self._some()):
            yield action.copy()

    def _rest(self) -> np.ndarray:
        """Action (A,) that asks for nothing new: grippers and absolute targets keep their last values."""
        action = np.array(self._control.rest(), np.float32)
        for channel in self._control.channels:
            if channel.kind == "gripper" or channel.rest is None:
                action[channel.slice] = self._last[channel.slice]
        return action

    def _absolute(self) -> np.ndarray:
        """Components (A,), bool, whose value is a target rather than a change."""
        return np.concatenate([np.full(c.stop - c.start, c.rest is None) for c in self._control.channels])

    def _random(self) -> Actions:
        """Uniformly random actions."""
        return islice(self._noise(), self._some())

    def _noise(self) -> Actions:
        while True:
            yield uniform(self._rng, self._task.action_size)

    def _wander(self) -> Actions:
        """Time-correlated noise around rest, as a sampling planner's."""
        rng = self._rng
        keep = rng.uniform(0.5, 0.95)
        spread = np.full(self._task.action_size, rng.uniform(0.1, 0.8))
        calm = rng.uniform(0.0, 1.0)
        for channel in self._control.of_kind("rotation", "yaw"):
            spread[channel.slice] *= calm
        mean = self._rest()
        noise = rng.normal(0.0, spread)
        for _ in range(self._some()):
            noise = keep * noise + np.sqrt(1 - keep**2) * rng.normal(0.0, spread)
            yield np.clip(mean + noise, -1, 1).astype(np.float32)


def uniform(rng: np.random.Generator, size: int) -> np.ndarray:
    """Uniformly random action (A,)."""
    return rng.uniform(-1.0, 1.0, size).astype(np.float32)
