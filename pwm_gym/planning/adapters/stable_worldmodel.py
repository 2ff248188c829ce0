"""A world model as a cost that stable-worldmodel's solvers descend: its ``Costable`` protocol.

The protocol is a class with two methods, so that the library itself is needed by its solvers alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError, unknown_name
from pwm_gym.planning.adapters.flat import FlatModel

__all__ = ["CostModel"]


class CostModel:
    """Costs of candidate action sequences: the sum, over the steps of a rollout, of the cost of where they lead.

    Args:
        flat: the model and the cost.
        key: entry of a solver's ``info_dict`` that holds states: vectors (E, X) of ``flat``, one an environment.

    Example:
        >>> solver = CEMSolver(CostModel(flat), num_samples=64, n_steps=5, topk=8)  # doctest: +SKIP
        >>> solver.configure(action_space=env.action_space, n_envs=1, config=PlanConfig(10, 1))  # doctest: +SKIP
        >>> solver.solve({"state": flat.vector(scene)[None]})["actions"].shape  # doctest: +SKIP
        torch.Size([1, 10, 7])
    """

    def __init__(self, flat: FlatModel, key: str = "state") -> None:
        self._flat = flat
        self._key = key

    def get_cost(self, info_dict: Mapping[str, Any], action_candidates: Tensor) -> Tensor:
        """Cost (E, S) of S candidates in each of E environments; it has a gradient by the actions.

        Args:
            info_dict: holds the states (E, S, X), or a history (E, S, T, X) of them, of which the last counts.
            action_candidates: (E, S, H, K A): H blocks of K actions. Values beyond [-1, 1] count as the bounds.

        Raises:
            PwmGymError: there are no states, or states or actions of another shape.
        """
        states = self._states(info_dict, action_candidates.shape[:2])
        size = self._flat.action_size
        if action_candidates.ndim != 4 or action_candidates.shape[-1] % size:
            found = tuple(action_candidates.shape)
            raise PwmGymError(f"candidates have shape {found}; expected (E, S, H, K x {size})")
        actions = action_candidates.to(states).clamp(-1.0, 1.0)
        actions = actions.reshape(*actions.shape[:2], -1, size)  # (E, S, H K, A)
        total = states.new_zeros(states.shape[:2])
        for action in actions.unbind(2):
            states = self._flat.step(states, action)
            total = total + self._flat.cost(states, action)
        return total

    def criterion(self, info_dict: Mapping[str, Any], action_candidates: Tensor) -> Tensor:
        """The same as :meth:`get_cost`, which the protocol also asks for."""
        return self.get_cost(info_dict, action_candidates)

    def _states(self, info_dict: Mapping[str, Any], batch: torch.Size) -> Tensor:
        """States (E, S, X) that the rollouts begin with."""
        if self._key not in info_dict:
            raise unknown_name("entry of info_dict", self._key, info_dict)
        values = info_dict[self._key]
        states = torch.as_tensor(np.ascontiguousarray(values) if isinstance(values, np.ndarray) else values)
        states = states.to(self._flat.device, torch.float32)
        if states.ndim == 4:
            states = states[:, :, -1]
        if states.shape != (*batch, self._flat.size):
            expected = (*batch, self._flat.size)
            raise PwmGymError(f"info_dict[{self._key!r}] has shape {tuple(states.shape)}; expected {expected}")
        return states.clone()
