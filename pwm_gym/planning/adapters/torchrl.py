"""A world model as a TorchRL environment, and inside TorchRL's MPPI."""

from __future__ import annotations

from typing import Any

import torch

from pwm_gym.errors import PwmGymError
from pwm_gym.planning.adapters.flat import FlatModel

try:
    from tensordict import TensorDict, TensorDictBase
    from tensordict.nn import TensorDictModuleBase
    from torchrl.data import Bounded, Composite, Unbounded
    from torchrl.envs import EnvBase
    from torchrl.modules import MPPIPlanner
except ModuleNotFoundError as error:
    raise PwmGymError(f"{error}; pip install 'pwm-gym[planners]'") from error

__all__ = ["TorchRLEnv", "torchrl_mppi"]


class TorchRLEnv(EnvBase):
    """Steps ``state`` (..., X) under ``action`` (..., A); the reward is minus the cost. Nothing ends an episode.

    A reset takes a tensordict of the wanted batch size: ``env.reset(TensorDict({}, [64]))``, and
    ``env.rollout(10, tensordict=TensorDict({}, [64]))`` rolls 64 sequences at once; gradients run through it. An agent,
    which needs success, time limits and points, takes ``torchrl.envs.GymWrapper`` of ``gym.make``'s environment.

    Args:
        flat: the model and the cost.
        start: vector (X,) that a reset gives.
    """

    batch_locked = False

    def __init__(self, flat: FlatModel, start: torch.Tensor) -> None:
        super().__init__(device=start.device, batch_size=torch.Size([]))
        self._flat, self._start = flat, start
        self.observation_spec = Composite(state=Unbounded((flat.size,), device=start.device))
        self.state_spec = self.observation_spec.clone()
        self.action_spec = Bounded(-1.0, 1.0, (flat.action_size,), device=start.device)
        self.reward_spec = Unbounded((1,), device=start.device)

    def _reset(self, tensordict: TensorDictBase | None, **_: Any) -> TensorDict:
        batch = torch.Size([]) if tensordict is None else tensordict.batch_size
        start = self._start.expand(*batch, -1).clone()
        return TensorDict({"state": start}, batch, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict["action"]
        moved = self._flat.step(tensordict["state"], action)
        reward = -self._flat.cost(moved, action).unsqueeze(-1)
        done = torch.zeros_like(reward, dtype=torch.bool)
        outcome = {"state": moved, "reward": reward, "done": done, "terminated": done.clone()}
        return TensorDict(outcome, tensordict.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        """The model is deterministic."""


class _Returns(TensorDictModuleBase):
    """Writes the rewards that are still to come (..., T, 1) as the advantage."""

    in_keys = [("next", "reward")]  # noqa: RUF012  (tensordict's own form)
    out_keys = ["advantage"]  # noqa: RUF012

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        reward = tensordict["next", "reward"]
        return tensordict.set("advantage", reward.flip(-2).cumsum(-2).flip(-2))


def torchrl_mppi(
    env: TorchRLEnv, samples: int = 100, elites: int = 32, horizon: int = 10, iterations: int = 1, scale: float = 0.1
) -> MPPIPlanner:
    """TorchRL's ``MPPIPlanner``, which maps a tensordict with a ``state`` to one with the next ``action``.

    Args:
        env: of the model.
        samples: action sequences an iteration.
        elites: best sequences that the next distribution is fitted to.
        horizon: steps that each looks ahead.
        iterations: rounds of sampling; each plan begins anew with standard normal actions.
        scale: its temperature, by which returns are multiplied.
    """
    return MPPIPlanner(env, _Returns(), scale, horizon, iterations, samples, elites)
