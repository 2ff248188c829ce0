"""A world model and a cost on vectors: the form in which general planners take a system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from pwm_gym.costs import cost_info, get_cost, get_grasp
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.scene import RigidState, Scene, State, batch_state
from pwm_gym.tasks import get_task

__all__ = ["FlatModel"]


class FlatModel:
    """States as vectors (..., X) of all that moves; the clouds and the goal are those of one scene.

    Args:
        model: world model.
        scene: that planning begins with.
        cost: a registered cost or a callable; None takes the task's planning cost.
        device: of the model.
    """

    def __init__(
        self,
        model: WorldModel,
        scene: Scene,
        cost: str | Callable[..., Tensor] | None = None,
        device: str = "cpu",
    ) -> None:
        self.model, self._task, self.device = model, get_task(scene.task), device
        self._cost = get_cost(self._task.plan_cost if cost is None else cost)
        self._grasp = get_grasp(self._task.grasp)
        self._state = self._prepared(scene)
        self._shapes = [x.shape[1:] for x in self._state.tensors[1:]]
        self.size = sum(s.numel() for s in self._shapes)
        """X."""
        self.action_size = self._task.action_size
        """A."""
        self._goal = torch.as_tensor(scene.goal, dtype=torch.float32, device=device)

    def vector(self, scene: Scene) -> Tensor:
        """Vector (X,) of a scene of the same entities and goal."""
        return self._vectors(self._prepared(scene))[0]

    def step(self, states: Tensor, actions: Tensor) -> Tensor:
        """States (..., X) one control step after actions (..., A)."""
        moved = self.model.step(self.state(states), actions.reshape(-1, self.action_size))
        return self._vectors(moved).view_as(states)

    def cost(self, states: Tensor, actions: Tensor) -> Tensor:
        """Cost (...) of states (..., X) after actions (..., A)."""
        flat = actions.reshape(-1, self.action_size)
        points, info = cost_info(self.state(states), flat, self._goal.expand(len(flat), -1), self._grasp)
        return self._cost(points, info).view(states.shape[:-1])

    def _prepared(self, scene: Scene) -> State:
        state = self.model.prepare(batch_state([scene], self.device))
        return replace(state, error=None) if isinstance(state, RigidState) else state

    def state(self, vectors: Tensor) -> State:
        """State (B,) of vectors (..., X)."""
        flat = vectors.reshape(-1, self.size)
        pieces = flat.split([s.numel() for s in self._shapes], -1)
        parts = [x.view(-1, *shape) for x, shape in zip(pieces, self._shapes, strict=True)]
        clouds = self._state.clouds.expand(len(flat), *self._state.clouds.shape[1:])
        values = iter([clouds, *parts])
        return self._state.map(lambda _: next(values))

    @staticmethod
    def _vectors(state: State) -> Tensor:
        """Vectors (B, X) of a state (B,)."""
        return torch.cat([x.flatten(1) for x in state.tensors[1:]], 1)
