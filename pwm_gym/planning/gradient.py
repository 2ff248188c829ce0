"""Planning by gradient descent on actions, through a differentiable model and cost."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError
from pwm_gym.planning.sampling import Objective, SamplingConfig, SamplingPlanner

__all__ = ["GradientConfig", "GradientPlanner"]


@dataclass(frozen=True)
class GradientConfig(SamplingConfig):
    """Settings of :class:`GradientPlanner`."""

    samples: int = 64
    """Action sequences of which the cheapest are refined."""
    elites: int = 8
    """Sequences that are refined at once."""
    iterations: int = 5
    """Gradient steps."""
    rate: float = 0.05
    """Adam's learning rate, in action units."""

    def check(self) -> None:
        """Refuse what cannot be.

        Raises:
            PwmGymError: naming the setting and what was expected.
        """
        super().check()
        if not self.rate > 0.0:
            raise PwmGymError(f"rate={self.rate}; expected more than 0")


class GradientPlanner(SamplingPlanner[GradientConfig]):
    """Adam on the cheapest of some samples; the plan is the cheapest sequence that was met."""

    def _improve(self, mean: Tensor, objective: Objective, generator: torch.Generator) -> Tensor:
        c = self.config
        actions = self._sample(mean, self._sigma, self._noise(len(mean), generator))
        cheapest, index = objective(actions).topk(c.elites, dim=1, largest=False)
        best = actions.gather(1, index[..., None, None].expand(-1, -1, *actions.shape[2:]))  # (B, K, H, A)
        free = torch.where(self._sigma > 0.0, 1.0, 0.0)  # a dimension without noise stays as it is
        with torch.enable_grad():
            refined = best.clone().requires_grad_()
            adam = torch.optim.Adam([refined], lr=c.rate)
            for _ in range(c.iterations):
                # Of the actions alone: a learned cost's own weights are to keep the gradients that they have.
                (gradient,) = torch.autograd.grad(objective(refined).sum(), refined)
                refined.grad = gradient * free
                adam.step()
                with torch.no_grad():
                    refined.clamp_(-self._bound, self._bound)
        costs = objective(refined.detach())
        better = costs < cheapest
        best = torch.where(better[..., None, None], refined.detach(), best)
        chosen = torch.where(better, costs, cheapest).argmin(1)  # (B,)
        return best[torch.arange(len(best)), chosen]
