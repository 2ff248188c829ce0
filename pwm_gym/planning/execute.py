"""Receding-horizon execution of a planner in an environment."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from pwm_gym.costs import get_cost, get_grasp
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.planning.mppi import MPPIConfig
from pwm_gym.planning.objective import RolloutObjective
from pwm_gym.planning.registry import build_planner
from pwm_gym.planning.sampling import Planner, SamplingConfig
from pwm_gym.scene import Scene, batch_state
from pwm_gym.tasks import get_task

__all__ = ["Agent", "Run", "closed_loop"]


class Agent:
    """A planner with a world model and a cost: scene in, action out.

    Args:
        model: world model to plan in.
        task: registered task.
        config: settings of the planner; None takes MPPI's.
        cost: a registered cost or a callable; None takes the task's planning cost.
        seed: of the planner's noise.
        device: of the model.
    """

    def __init__(
        self,
        model: WorldModel,
        task: str = "PickCube",
        config: SamplingConfig | None = None,
        cost: str | Callable[..., torch.Tensor] | None = None,
        seed: int = 0,
        device: str = "cpu",
    ) -> None:
        self.task, self.device = get_task(task), device
        self.planner: Planner = build_planner(config or MPPIConfig(), self.task.action_size, device)
        chosen = get_cost(self.task.plan_cost if cost is None else cost)
        self.objective = RolloutObjective(model, chosen, get_grasp(self.task.grasp))
        self._generator = torch.Generator(device).manual_seed(seed)

    def reset(self, seed: int) -> None:
        """Forget the last plan and reseed the noise."""
        self.planner.reset()
        self._generator.manual_seed(seed)

    def act(self, scene: Scene) -> np.ndarray:
        """First action (A,) of the plan from ``scene``."""
        return self.plan(scene)[0]

    def plan(self, scene: Scene) -> np.ndarray:
        """Planned actions (H, A) from ``scene``."""
        state = batch_state([scene], self.device)
        goal = torch.as_tensor(scene.goal, dtype=torch.float32, device=self.device)[None]
        return self.planner.plan(self.objective.begin(state, goal), self._generator)[0].cpu().numpy()


@dataclass
class Run:
    """What happened in one episode."""

    seed: int
    success: bool = False
    at_reset: bool = False
    """Whether it was a success before the first action; such seeds are left out of tables."""
    actions: list[np.ndarray] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    plan_seconds: list[float] = field(default_factory=list)
    infos: list[dict[str, Any]] = field(default_factory=list)

    @property
    def steps(self) -> int:
        """Actions executed."""
        return len(self.actions)


def closed_loop(
    env: gym.Env[Any, Any],
    agent: Agent,
    seed: int,
    max_steps: int = 100,
    on_scene: Callable[[Scene], None] | None = None,
) -> Run:
    """Plan and execute one action at a time until success or ``max_steps``.

    Args:
        env: a twin or model environment; the agent sees ``env.unwrapped.scene()``.
        agent: plans.
        seed: of the episode and of the planner's noise.
        max_steps: actions at most.
        on_scene: called with the scene before the first action and after each.
    """
    base: Any = env.unwrapped
    _, info = env.reset(seed=seed)
    agent.reset(seed)
    run = Run(seed, at_reset=bool(info["success"]))

    def show(scene: Scene) -> Scene:
        if on_scene is not None:
            on_scene(scene)
        return scene

    scene = show(base.scene())
    for _ in range(max_steps):
        begun = time.perf_counter()
        action = agent.act(scene)
        run.plan_seconds.append(time.perf_counter() - begun)
        _, reward, terminated, truncated, info = env.step(action)
        run.actions.append(action)
        run.rewards.append(float(reward))
        run.infos.append(info)
        scene = show(base.scene())
        if terminated or truncated:
            break
    run.success = bool(info["success"])
    return run
