"""The cross-entropy method for planning, and iCEM (Pinneri et al., 2020)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError
from pwm_gym.planning.noise import power_law_noise
from pwm_gym.planning.sampling import Objective, SamplingConfig, SamplingPlanner

__all__ = ["CEM", "CEMConfig"]


@dataclass(frozen=True)
class CEMConfig(SamplingConfig):
    """Settings of the cross-entropy method; :meth:`icem` gives iCEM's."""

    elites: int = 20
    """Cheapest sequences that the next distribution is fitted to."""
    iterations: int = 3
    """Rounds of sampling around the improved mean."""
    inertia: float = 0.1
    """Share of the last mean and standard deviation that stays in the next (iCEM's alpha)."""
    floor: float = 0.05
    """Share of ``sigma`` below which no standard deviation falls."""
    noise_beta: float | None = None
    """Exponent of power-law noise, instead of noise of the channels' ``correlation``."""
    shrink: float = 1.0
    """Factor by which each iteration has fewer samples, twice the elites at least."""
    keep_elite_fraction: float = 0.0
    """Share of the elites that are samples of the next iteration, and, one step on, of the next plan."""
    best: bool = False
    """Whether the plan is the cheapest sequence of all, or else the last distribution's mean."""

    def check(self) -> None:
        """Refuse what cannot be.

        Raises:
            PwmGymError: naming the setting and what was expected.
        """
        super().check()
        for name in ("inertia", "floor", "keep_elite_fraction"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise PwmGymError(f"{name}={getattr(self, name)}; expected 0 to 1")
        if self.shrink < 1.0:
            raise PwmGymError(f"shrink={self.shrink}; expected at least 1")

    @classmethod
    def icem(cls, horizon: int = 10) -> CEMConfig:
        """iCEM: coloured noise, elites that are kept, ever fewer samples, the best sequence.

        As with all planners here, and not as published, some samples search wide and some refine
        (``min_noise_scale``). Without it the fingers often wait around an object and do not shut.
        """
        return cls(horizon=horizon, noise_beta=2.0, shrink=1.25, keep_elite_fraction=0.3, best=True)


class CEM(SamplingPlanner[CEMConfig]):
    """Fits a normal distribution to the cheapest samples, and samples from it anew."""

    _elites: Tensor | None = None  # (B, K, H, A)

    def reset(self) -> None:
        """Forget the last plan and its elites."""
        super().reset()
        self._elites = None

    def _improve(self, mean: Tensor, objective: Objective, generator: torch.Generator) -> Tensor:
        c = self.config
        sigma = self._sigma.expand_as(mean)
        kept = self._shifted_elites(len(mean))
        plan, cheapest = mean, mean.new_full((len(mean),), torch.inf)
        for k in range(c.iterations):
            count = max(int(c.samples / c.shrink**k), min(c.samples, 2 * c.elites))
            actions = self._sample(mean, sigma, self._unit_noise(len(mean), generator)[:, -count:])
            if kept is not None:
                actions = torch.cat([actions, kept], 1)
            costs = objective(actions)  # (B, S)
            best, index = costs.topk(c.elites, dim=1, largest=False)
            elites = actions.gather(1, index[..., None, None].expand(-1, -1, *actions.shape[2:]))
            fitted = elites.std(1) if c.elites > 1 else torch.zeros_like(mean)
            mean = c.inertia * mean + (1.0 - c.inertia) * elites.mean(1)
            sigma = (c.inertia * sigma + (1.0 - c.inertia) * fitted).maximum(c.floor * self._sigma)
            better = best[:, 0] < cheapest
            plan = torch.where(better[:, None, None], elites[:, 0], plan)
            cheapest = torch.where(better, best[:, 0], cheapest)
            kept = elites[:, : round(c.keep_elite_fraction * c.elites)] if c.keep_elite_fraction else None
        self._elites = kept
        return plan if c.best else mean

    def _unit_noise(self, batch: int, generator: torch.Generator) -> Tensor:
        """Standard normal noise (B, S, H, A)."""
        c = self.config
        if c.noise_beta is None:
            return self._noise(batch, generator)
        return power_law_noise((batch, c.samples, c.horizon, self.action_size), c.noise_beta, generator)

    def _shifted_elites(self, batch: int) -> Tensor | None:
        """The last plan's elites one step on, their last actions repeated."""
        if self._elites is None or len(self._elites) != batch:
            return None
        return torch.cat([self._elites[:, :, 1:], self._elites[:, :, -1:]], 2)
