"""What planners that sample action sequences share: settings, noise, warm starts, samples that stop early."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError

__all__ = ["Objective", "Planner", "SamplingConfig", "SamplingPlanner", "power_law_noise"]

Objective = Callable[[Tensor], Tensor]
"""Actions (B, S, H, A) -> costs (B, S), differentiable where the model and the cost are."""


class Planner(Protocol):
    """Improves action sequences, batched over environments, and starts from its last plan."""

    def reset(self) -> None:
        """Forget the last plan."""

    def plan(self, objective: Objective, generator: torch.Generator, batch: int = 1) -> Tensor:
        """Action sequences (B, H, A), the first of which is to be executed.

        Args:
            objective: costs (B, S) of action sequences (B, S, H, A).
            generator: source of the noise.
            batch: B, environments planned for at once.
        """


@dataclass(frozen=True)
class SamplingConfig:
    """Settings that all sampling planners have. The defaults are tuned on PickCube's planning-validation seeds."""

    samples: int = 100
    """Action sequences an iteration."""
    horizon: int = 10
    """Steps that each looks ahead."""
    elites: int = 32
    """Cheapest sequences that the next plan is made of."""
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
    bound: tuple[float, ...] = (1.0,)
    """Largest size of an action, for each dimension or one for all; at most 1."""
    iterations: int = 1
    """Rounds of sampling around the improved mean."""

    def resize(self, samples: int) -> Self:
        """The same settings with so many samples, and elites in proportion."""
        return replace(self, samples=samples, elites=max(1, round(self.elites * samples / self.samples)))

    def check(self, action_size: int) -> None:
        """Refuse what cannot be, for actions of ``action_size`` dimensions.

        Raises:
            PwmGymError: naming the setting and what was expected.
        """
        for name in ("sigma", "finest", "correlation", "bound"):
            count = len(getattr(self, name))
            if count not in (1, action_size):
                raise PwmGymError(f"{name} has {count} values; expected 1 or {action_size}")
        for name in ("horizon", "iterations"):
            if getattr(self, name) < 1:
                raise PwmGymError(f"{name}={getattr(self, name)}; expected at least 1")
        if not all(0.0 < b <= 1.0 for b in self.bound):
            raise PwmGymError(f"bound={self.bound}; expected more than 0 and at most 1")
        if self.stops < 0:
            raise PwmGymError(f"stops={self.stops}; expected 0 or more")
        if not 1 <= self.elites <= self.samples:
            raise PwmGymError(f"elites={self.elites}; expected 1 to samples={self.samples}")


Config = TypeVar("Config", bound=SamplingConfig)


class SamplingPlanner(ABC, Generic[Config]):
    """Samples around the last plan, and makes the next one of the cheapest samples.

    Args:
        config: settings.
        action_size: A.
        device: where the plans live.

    Raises:
        PwmGymError: a setting that cannot be.
    """

    def __init__(self, config: Config, action_size: int, device: torch.device | str = "cpu") -> None:
        config.check(action_size)
        self.config, self.action_size = config, action_size
        scale = torch.linspace(0.0, 1.0, config.samples, device=device).unsqueeze(-1)  # of each sample's noise
        finest = torch.tensor(config.finest, device=device)
        self._sigma = torch.tensor(config.sigma, device=device).expand(action_size)
        self._fan = (1.0 - scale * (1.0 - finest)).unsqueeze(1)  # (S, 1, A or 1)
        self._stops = min(config.stops, config.horizon, config.samples // 4)
        self._bound = torch.tensor(config.bound, device=device)
        self._keep = torch.tensor(config.correlation, device=device)
        self._fresh = (1.0 - self._keep.square()).sqrt()
        self._mean: Tensor | None = None  # (B, H, A)

    def reset(self) -> None:
        """Forget the last plan."""
        self._mean = None

    @torch.no_grad()
    def plan(self, objective: Objective, generator: torch.Generator, batch: int = 1) -> Tensor:
        """Improved action sequences (B, H, A), started from the last plan shifted by one step.

        Args:
            objective: costs (B, S) of action sequences (B, S, H, A).
            generator: source of the noise.
            batch: B, environments planned for at once.
        """
        self._mean = self._improve(self._warm_start(batch), objective, generator)
        return self._mean

    @abstractmethod
    def _improve(self, mean: Tensor, objective: Objective, generator: torch.Generator) -> Tensor:
        """The next plan (B, H, A), sought around ``mean`` (B, H, A)."""

    def _warm_start(self, batch: int) -> Tensor:
        """The last plan one step on, its last action repeated; a resting arm with an open gripper at first."""
        if self._mean is None or len(self._mean) != batch:
            rest = torch.zeros(batch, self.config.horizon, self.action_size, device=self._sigma.device)
            rest[..., -1] = self._bound[-1]
            return rest
        return torch.cat([self._mean[:, 1:], self._mean[:, -1:]], 1)

    def _sample(self, mean: Tensor, sigma: Tensor, noise: Tensor) -> Tensor:
        """Sequences (B, S, H, A) around ``mean``; the last is the mean itself, and those before it stop early.

        Args:
            mean: (B, H, A).
            sigma: standard deviations (B, H, A), or what broadcasts to them.
            noise: (B, S, H, A), standard normal.
        """
        spread = sigma.unsqueeze(-3) if sigma.ndim == 3 else sigma
        count = noise.shape[1]
        actions = (mean.unsqueeze(1) + spread * self._fan[-count:] * noise).clamp(-self._bound, self._bound)
        actions[:, -1] = mean
        for step in range(min(self._stops, count // 4)):
            stopping = actions[:, -2 - step]
            stopping[:] = mean
            stopping[:, step:, :-1] = 0.0
            stopping[:, step:, -1] = mean[:, max(step - 1, 0), -1:]
        return actions

    def _noise(self, batch: int, generator: torch.Generator) -> Tensor:
        """Standard normal noise (B, S, H, A), correlated from step to step."""
        c = self.config
        noise = torch.randn(
            (batch, c.samples, c.horizon, self.action_size), generator=generator, device=self._sigma.device
        )
        for h in range(1, c.horizon):
            noise[:, :, h] = self._keep * noise[:, :, h - 1] + self._fresh * noise[:, :, h]
        return noise


def power_law_noise(shape: tuple[int, ...], exponent: float, generator: torch.Generator) -> Tensor:
    """Standard normal noise (..., H, A) whose power falls with the frequency along H as ``1 / f ** exponent``.

    Timmer and Koenig's construction (1995), as iCEM samples actions; an exponent of 0 is white.
    """
    *front, horizon, size = shape
    frequencies = torch.fft.rfftfreq(horizon, device=generator.device).clamp_min(1.0 / horizon)
    scale = frequencies.pow(-0.5 * exponent)
    parts = torch.randn((*front, size, len(scale), 2), generator=generator, device=generator.device)
    spectrum = torch.view_as_complex(parts) * scale
    spectrum[..., 0] = spectrum[..., 0].real * 2**0.5  # the mean and, of an even length, the highest one are real
    if horizon % 2 == 0:
        spectrum[..., -1] = spectrum[..., -1].real * 2**0.5
    pairs = torch.full_like(scale, 2.0)  # every other frequency stands for its negative, too
    pairs[0] = 1.0
    if horizon % 2 == 0:
        pairs[-1] = 1.0
    total = (pairs * scale.square()).sum()
    noise = torch.fft.irfft(spectrum, n=horizon, dim=-1) * horizon / (2.0 * total).sqrt()
    return noise.transpose(-1, -2)
