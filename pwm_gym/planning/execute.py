"""Execution of an agent in an environment: closed loop, in chunks, or open loop for a whole episode."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np

from pwm_gym.costs import Cost
from pwm_gym.costs.registry import Function
from pwm_gym.errors import PwmGymError
from pwm_gym.planning.agent import Agent
from pwm_gym.planning.run import Run
from pwm_gym.scene import Scene, State, batch_state, stack
from pwm_gym.scene.se3 import pose7_from_matrix

__all__ = ["execute"]


class Rules(Protocol):
    """What an environment rewards by."""

    @property
    def cost(self) -> Cost:
        """Cost whose negative is the reward."""

    @property
    def grasp(self) -> Function:
        """Grasp rule that the cost is told of."""


@runtime_checkable
class Judged(Protocol):
    """An environment that tells what it rewards by; others are taken to reward by the task's own cost."""

    @property
    def rules(self) -> Rules:
        """Cost and grasp rule."""


def execute(
    env: gym.Env[Any, Any],
    agent: Agent,
    seed: int,
    max_steps: int = 100,
    chunk: int = 1,
    observe: Callable[[Scene], Scene] | None = None,
    to_the_end: bool = False,
) -> Run:
    """Plan and execute until success or ``max_steps``.

    Every action is planned anew, from the present scene where the agent looks, and from the model's own prediction
    between two looks (paper, section 4.2: open-loop planning stresses the model).

    Args:
        env: a twin or model environment; the agent sees ``env.unwrapped.scene()``, and the record holds the truth.
        agent: plans.
        seed: of the episode and of the planner's noise.
        max_steps: actions at most.
        chunk: actions between two looks: 1 is closed loop, 0 looks at the first scene alone (open loop).
        observe: what the agent sees of a scene; None shows all of it.
        to_the_end: whether to go on after success, up to ``max_steps``: does it last? Twins can.

    Raises:
        PwmGymError: a negative chunk, or no steps.
    """
    if max_steps < 1:
        raise PwmGymError(f"max_steps={max_steps}; expected at least 1")
    if chunk < 0:
        raise PwmGymError(f"chunk={chunk}; expected 0 (open loop) or more")
    base: Any = env.unwrapped
    _, info = env.reset(seed=seed)
    agent.reset(seed)
    at_reset = bool(info["success"])
    scenes: list[Scene] = [base.scene(truth=True)]
    shown: Scene = base.scene()
    actions, rewards, solved, seconds, predicted = [], [], [], [], []
    for step in range(max_steps):
        seen = None
        if step == 0 or (chunk and step % chunk == 0):
            seen = base.scene() if observe is None else observe(base.scene())
        begun = time.perf_counter()
        action = agent.act(seen)
        seconds.append(time.perf_counter() - begun)
        predicted.append(agent.advance(action))
        _, reward, terminated, truncated, info = env.step(action)
        actions.append(action)
        rewards.append(float(reward))
        solved.append(bool(info["success"]))
        scenes.append(base.scene(truth=True))
        if truncated or (terminated and not (solved[-1] and to_the_end)):
            break
    rules = base.rules if isinstance(base, Judged) else None
    judged = _judged(agent, rules, scenes, stack([s[0] for s in predicted], 0), np.stack(actions))
    return Run(
        start=scenes[0],
        shown=None if np.array_equal(shown.clouds, scenes[0].clouds) else shown,
        seed=seed,
        success=any(solved),
        actions=np.stack(actions),
        rewards=np.array(rewards),
        solved=np.array(solved),
        plan_seconds=np.array(seconds),
        poses=np.stack([s.poses[0] for s in scenes]),
        chunk=chunk,
        at_reset=at_reset,
        settings={**agent.describe(), **({"reward_cost": rules.cost.name} if rules else {})},
        **judged,
    )


def _judged(
    agent: Agent, rules: Rules | None, scenes: list[Scene], predicted: State, actions: np.ndarray
) -> dict[str, Any]:
    """Predicted poses, and the costs of predicted states (T,) and real scenes (T + 1), as fields of a run."""
    by = () if rules is None else (rules.cost, rules.grasp)
    return {
        "predicted": pose7_from_matrix(predicted.poses().double().cpu()).numpy(),
        "predicted_rewards": agent.rewards(predicted, actions, *by),
        "terms": agent.terms(batch_state(scenes[1:], agent.device), actions),
        "predicted_terms": agent.terms(predicted, actions),
    }
