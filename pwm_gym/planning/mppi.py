"""Model predictive path integral control (Williams et al., 2017), as the paper plans with it (section 3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError

__all__ = ["MPPI", "MPPIConfig", "Objective"]

Objective = Callable[[Tensor], Tensor]
"""Actions (B, S, H, A) -> costs (B, S)."""


@dataclass(frozen=True)
class MPPIConfig:
    """Settings of MPPI. The defaults are tuned on PickCube's planning-validation seeds."""

    samples: int = 200
    """Action sequences an iteration."""
    horizon: int = 10
    """Steps that each looks ahead."""
    elites: int = 64
    """Cheapest sequences that are averaged (the paper's "top candidates")."""
    temperature: float = 0.05
    """The paper's lambda: the cost difference that makes a sequence e times less likely."""
    relative: bool = True
    """Whether the temperature is in units of the elites' cost spread."""
    sigma: tuple[float, ...] = (0.3, 0.3, 0.3, 0.0, 0.0, 0.3, 0.7)
    """Noise's standard deviation in action units, for each action dimension or one for all."""
    correlation: tuple[float, ...] = (0.7, 0.7, 0.7, 0.7, 0.7, 0.7, 0.97)
    """Correlation of the noise from one step to the next, for each dimension or one for all; 0 is white. A gripper's is
    high: one step's opening drops what is held, which would hide all other differences between the samples."""
    finest: tuple[float, ...] = (0.2, 0.2, 0.2, 1.0, 1.0, 0.2, 1.0)
    """The samples' noise is scaled from 1 down to this, for each dimension or one for all, so that some search wide and
    some refine; a gripper's is not, since only wide noise shuts it."""
    stops: int = 10
    """Samples that follow the last plan for 0, 1, 2, ... steps and then stand still, the gripper as it was: noise finds
    no such sequence, and a task may ask for one at its end. At most the horizon and a quarter of the samples."""
    iterations: int = 1
    """Rounds of sampling around the improved mean."""

    @classmethod
    def paper(cls, horizon: int = 10) -> MPPIConfig:
        """The paper's table; sigma 5 on actions in [-1, 1] saturates most samples."""
        return cls(200, horizon, 64, 0.7, relative=False, sigma=(5.0,), correlation=(0.0,), finest=(1.0,), stops=0)


class MPPI:
    """Plans by sampling around the last plan; batched over environments.

    Args:
        config: settings.
        action_size: A.
        device: where the plans live.

    Raises:
        PwmGymError: a setting that cannot be.
    """

    def __init__(self, config: MPPIConfig, action_size: int, device: torch.device | str = "cpu") -> None:
        for name in ("sigma", "finest", "correlation"):
            count = len(getattr(config, name))
            if count not in (1, action_size):
                raise PwmGymError(f"{name} has {count} values; expected 1 or {action_size}")
        for name in ("horizon", "iterations"):
            if getattr(config, name) < 1:
                raise PwmGymError(f"{name}={getattr(config, name)}; expected at least 1")
        if not config.temperature > 0.0:
            raise PwmGymError(f"temperature={config.temperature}; expected more than 0")
        if config.stops < 0:
            raise PwmGymError(f"stops={config.stops}; expected 0 or more")
        if not 1 <= config.elites <= config.samples:
            raise PwmGymError(f"elites={config.elites}; expected 1 to samples={config.samples}")
        self.config, self.action_size = config, action_size
        sigma = torch.tensor(config.sigma, device=device).expand(action_size)
        scale = torch.linspace(0.0, 1.0, config.samples, device=device).unsqueeze(-1)  # of each sample's noise
        finest = torch.tensor(config.finest, device=device)
        self._sigma = (sigma * (1.0 - scale * (1.0 - finest))).unsqueeze(1)  # (S, 1, A)
        self._stops = min(config.stops, config.horizon, config.samples // 4)
        self._keep = torch.tensor(config.correlation, device=device)
        self._fresh = (1.0 - self._keep.square()).sqrt()
        self._mean: Tensor | None = None  # (B, H, A)

    def reset(self) -> None:
        """Forget the last plan."""
        self._mean = None

    def plan(self, objective: Objective, generator: torch.Generator, batch: int = 1) -> Tensor:
        """Improved action sequences (B, H, A), started from the last plan shifted by one step.

        Args:
            objective: costs (B, S) of action sequences (B, S, H, A).
            generator: source of the noise.
            batch: B, environments planned for at once.
        """
        mean = self._warm_start(batch)
        for _ in range(self.config.iterations):
            actions = self._sample(mean, generator)  # (B, S, H, A)
            costs = objective(actions)  # (B, S)
            mean = self._average(actions, costs)
        self._mean = mean
        return mean

    def _warm_start(self, batch: int) -> Tensor:
        """The last plan one step on, its last action repeated; a resting arm with an open gripper at first."""
        if self._mean is None or len(self._mean) != batch:
            rest = torch.zeros(batch, self.config.horizon, self.action_size, device=self._sigma.device)
            rest[..., -1] = 1.0
            return rest
        return torch.cat([self._mean[:, 1:], self._mean[:, -1:]], 1)

    def _sample(self, mean: Tensor, generator: torch.Generator) -> Tensor:
        """Sequences (B, S, H, A) around ``mean``; the last is the mean itself, and those before it stop early."""
        c = self.config
        shape = (len(mean), c.samples, c.horizon, self.action_size)
        noise = torch.randn(shape, generator=generator, device=mean.device)
        for h in range(1, c.horizon):
            noise[:, :, h] = self._keep * noise[:, :, h - 1] + self._fresh * noise[:, :, h]
        noise[:, -1] = 0.0
        actions = (mean.unsqueeze(1) + self._sigma * noise).clamp(-1.0, 1.0)
        for step in range(self._stops):
            stopping = actions[:, -2 - step]
            stopping[:] = mean
            stopping[:, step:, :-1] = 0.0
            stopping[:, step:, -1] = mean[:, max(step - 1, 0), -1:]
        return actions

    def _average(self, actions: Tensor, costs: Tensor) -> Tensor:
        """Elites' mean (B, H, A), weighted by exp(-cost / temperature)."""
        best, index = costs.topk(self.config.elites, dim=1, largest=False)  # (B, K)
        scale = self.config.temperature
        if self.config.relative:
            spread = (best[:, -1:] - best[:, :1]).clamp_min(1e-6)
            weights = torch.softmax(-(best - best[:, :1]) / (scale * spread), 1)
        else:
            weights = torch.softmax(-(best - best[:, :1]) / scale, 1)
        elites = actions.gather(1, index[..., None, None].expand(-1, -1, *actions.shape[2:]))
        return (weights[..., None, None] * elites).sum(1).clamp(-1.0, 1.0)  # rounding may leave the limits
