"""A world model inside ``pytorch_mppi``'s MPPI."""

from __future__ import annotations

from typing import Any

import torch

from pwm_gym.errors import PwmGymError
from pwm_gym.planning.adapters.flat import FlatModel

__all__ = ["pytorch_mppi"]


def pytorch_mppi(
    flat: FlatModel, sigma: tuple[float, ...], samples: int = 100, horizon: int = 10, temperature: float = 0.7
) -> Any:
    """A ``pytorch_mppi.MPPI``; its ``command(flat.vector(scene))`` is the next action (A,).

    Args:
        flat: the model and the cost.
        sigma: standard deviations (A,) of its noise, in action units; more than 0.
        samples: action sequences.
        horizon: steps that each looks ahead.
        temperature: its lambda.

    Raises:
        PwmGymError: the library is not installed, or a standard deviation that cannot be.
    """
    try:
        from pytorch_mppi import MPPI
    except ModuleNotFoundError as error:
        raise PwmGymError(f"{error}; pip install 'pwm-gym[planners]'") from error
    if len(sigma) != flat.action_size or not all(s > 0.0 for s in sigma):
        raise PwmGymError(f"sigma={sigma}; expected {flat.action_size} values more than 0")
    bound = torch.ones(flat.action_size, device=flat.device)
    return MPPI(
        torch.no_grad()(flat.step),
        torch.no_grad()(flat.cost),
        flat.size,
        torch.diag(torch.tensor(sigma, dtype=torch.float32, device=flat.device).square()),
        num_samples=samples,
        horizon=horizon,
        device=flat.device,
        lambda_=temperature,
        u_min=-bound,
        u_max=bound,
    )
