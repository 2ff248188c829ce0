"""The cost of action sequences, by one batched rollout of a world model."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from pwm_gym.costs import Cost, StagedCost, cost_info
from pwm_gym.costs.registry import Function
from pwm_gym.dynamics.model import WorldModel, rollout
from pwm_gym.dynamics.protocols import expected_error
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import RigidState, State

__all__ = ["MOST_POINTS", "RolloutObjective"]

MOST_POINTS = 2048
"""Points of a scene that costs read in every predicted step."""


class RolloutObjective:
    """Sum of a cost over the predicted steps, the last one counted more.

    Args:
        model: world model.
        cost: cost of a state.
        grasp: rule for ``info["grasped"]``.
        terminal: extra weight of the last step.
        points: points an entity that the cost reads (rigid models only); None reads all, but of a scene of more than
            :data:`MOST_POINTS` its entities' shares of these.
        caution: cost of a metre of expected error (the entities' sum) at a step.
    """

    def __init__(
        self,
        model: WorldModel,
        cost: Cost,
        grasp: Function,
        terminal: float = 2.0,
        points: int | None = None,
        caution: float = 0.0,
    ) -> None:
        self.model, self.cost, self.grasp, self.terminal, self.points = model, cost, grasp, terminal, points
        self.caution = caution
        self._state: State | None = None
        self._goal = torch.empty(0)
        self._stage: Tensor | None = None

    def begin(self, state: State, goal: Tensor, stage: Tensor | None = None) -> RolloutObjective:
        """Plan from ``state`` (B,) towards ``goal`` (B, G), in ``stage`` (B,) of a staged cost; None is its first.

        Raises:
            PwmGymError: caution is asked for with a model that does not tell its expected error.
        """
        state = self.model.prepare(state)
        if self.caution and expected_error(state) is None:
            kind = type(self.model).__name__
            raise PwmGymError(f"caution={self.caution}; {kind} does not tell its expected error")
        if isinstance(state, RigidState):
            state = state if self.caution else replace(state, error=None)
            if self.points is not None:
                state = state.coarsen(state.layout.truncate(self.points))
            elif state.layout.points > MOST_POINTS:
                state = state.coarsen(state.layout.resize(MOST_POINTS))
        self._state, self._goal, self._stage = state, goal, stage
        return self

    def __call__(self, actions: Tensor) -> Tensor:
        """Costs (B, S) of action sequences (B, S, H, A), differentiable where the actions ask for it."""
        if actions.requires_grad:
            return self._evaluate(actions)
        with torch.inference_mode():  # a tenth faster than without gradients alone
            costs = self._evaluate(actions)
        return costs.clone()

    def _evaluate(self, actions: Tensor) -> Tensor:
        assert self._state is not None, "call begin() first"
        batch, samples, horizon, size = actions.shape
        start = self._state.map(lambda x: _repeat(x, samples))
        states = rollout(self.model, start, actions.flatten(0, 1), prepared=True)  # (B S, H)
        flat = states.map(lambda x: x.flatten(0, 1))
        goal = _repeat(self._goal, samples * horizon)
        points, info = cost_info(flat, actions.reshape(-1, size), goal, self.grasp)
        if isinstance(self.cost, StagedCost):
            first = self.cost.begin(batch, goal.device) if self._stage is None else self._stage
            info["stage"] = self.cost.along(_repeat(first, samples), points, info, horizon).flatten()
        costs = self.cost(points, info)
        if self.caution and (error := expected_error(flat)) is not None:
            costs = costs + self.caution * error.sum(-1)
        costs = costs.view(batch, samples, horizon)
        return costs.sum(-1) + self.terminal * costs[..., -1]


def _repeat(value: Tensor, times: int) -> Tensor:
    """Each of (B, ...) repeated ``times`` times, (B times, ...); a view where B is 1."""
    return value.unsqueeze(1).expand(-1, times, *value.shape[1:]).flatten(0, 1)
