"""What planners that sample action sequences share: settings, noise, warm starts, samples that stop early."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, Self, TypeVar

import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError
from pwm_gym.planning.noise import ActionNoise, counterparts, sample_mask, share_mask, together_mask
from pwm_gym.robots import Control

__all__ = ["Objective", "Planner", "SamplingConfig", "SamplingPlanner"]

_FINEST = 1e-3  # smallest factor of noise that shrinks by factors

Objective = Callable[[Tensor], Tensor]
"""Actions (B, S, H, A) -> costs (B, S), differentiable where the model and the cost are."""


class Planner(Protocol):
    """Improves action sequences, batched over environments, and starts from its last plan."""

    @property
    def horizon(self) -> int:
        """Steps that a plan looks ahead."""

    def reset(self) -> None:
        """Forget the last plan."""

    def plan(
        self,
        objective: Objective,
        generator: torch.Generator,
        batch: int = 1,
        last_action: Tensor | None = None,
        proposal: Tensor | None = None,
    ) -> Tensor:
        """Action sequences (B, H, A), the first of which is to be executed.

        Args:
            objective: costs (B, S) of action sequences (B, S, H, A).
            generator: source of the noise.
            batch: B, environments planned for at once.
            last_action: actions (B, A) that led to the present state, where they are known: absolute targets and
                grippers begin there.
            proposal: action sequences (B, H, A), a policy's for instance, to start from where they are cheaper than the
                last plan.
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
    noise: ActionNoise = field(default_factory=ActionNoise)
    """Noise of each kind of channel that an action may have."""
    stop_samples: int = 10
    """Samples that follow the last plan for 0, 1, 2, ... steps and then stand still, grippers and fingers as they were:
    noise finds no such sequence, and a task may ask for one at its end. At most the horizon and a quarter of the
    samples."""
    single_arm_share: float = 0.5
    """Share of the samples that perturb one arm alone, each arm in turn, where a robot has several."""
    together_share: float = 0.0
    """Share of the samples in which all arms go the same way, every other of them along one axis alone, and nothing
    else is perturbed: what several hands hold goes with them."""
    single_component_share: float = 0.0
    """Share of the samples that perturb one component alone, each in turn: where a task asks for exact places, a good
    turn of the hand or a way straight down is lost among the bad motions that come with it."""
    single_channel_share: float = 0.0
    """Share of the samples that perturb one channel alone, each in turn: the way, the turn or the fingers of one hand,
    where a robot has many components."""
    geometric_scales: bool = False
    """Whether the samples' noise shrinks by a factor from one to the next, not by a difference, so that as many refine
    as search wide; the finest are then not those that the stop samples replace."""
    iterations: int = 1
    """Rounds of sampling around the improved mean."""
    posture: bool = False
    """Whether hands keep their posture by themselves (:class:`pwm_gym.planning.posture.Posture`): upright, turned and
    shaped as the task tells. That is then no part of a plan."""

    def __post_init__(self) -> None:
        """Check each value."""
        self.check()

    def resize(self, samples: int) -> Self:
        """The same settings with so many samples, and elites in proportion."""
        return replace(self, samples=samples, elites=max(1, round(self.elites * samples / self.samples)))

    def check(self) -> None:
        """Refuse what cannot be.

        Raises:
            PwmGymError: naming the setting and what was expected.
        """
        for name in ("horizon", "iterations"):
            if getattr(self, name) < 1:
                raise PwmGymError(f"{name}={getattr(self, name)}; expected at least 1")
        if self.stop_samples < 0:
            raise PwmGymError(f"stop_samples={self.stop_samples}; expected 0 or more")
        for name in ("single_arm_share", "together_share", "single_component_share", "single_channel_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise PwmGymError(f"{name}={getattr(self, name)}; expected 0 to 1")
        if not 1 <= self.elites <= self.samples:
            raise PwmGymError(f"elites={self.elites}; expected 1 to samples={self.samples}")


Config = TypeVar("Config", bound=SamplingConfig)


class SamplingPlanner(ABC, Generic[Config]):
    """Samples around the last plan, and makes the next one of the cheapest samples.

    Args:
        config: settings.
        control: meaning of an action's components.
        device: where the plans live.
        fixed: components of an action that samples leave as they are: something else decides them.

    Raises:
        PwmGymError: a setting that cannot be, or one that does not fit the control.
    """

    def __init__(
        self, config: Config, control: Control, device: torch.device | str = "cpu", fixed: Sequence[int] = ()
    ) -> None:
        self.config, self.action_size = config, control.size
        noise = config.noise.resolve(control)

        def tensor(values: tuple[float, ...]) -> Tensor:
            return torch.tensor(values, dtype=torch.float32, device=device)

        self._sigma, self._bound = tensor(noise.sigma), tensor(noise.bound)
        self._sigma[list(fixed)] = 0.0
        self._correlation = tensor(noise.correlation)
        self._fresh = (1.0 - self._correlation.square()).sqrt()
        self._stop_samples = min(config.stop_samples, config.horizon, config.samples // 4)
        mixing = noise.mixing()
        self._mixing = None if mixing is None else mixing.to(device)
        self._together = share_mask(config.samples, config.together_share, step=3).to(device)
        self._counterparts = torch.tensor(counterparts(control), device=device)
        self._least = tensor(noise.min_noise_scale)
        self._scale = self._noise_scale(control)
        # What standing still means: absolute targets and hands stay as they are, all else returns to its rest value.
        absolute = [c.rest is None for c in control.channels for _ in range(c.start, c.stop)]
        hands = [kind in ("gripper", "finger") for kind in control.kinds]
        self._rest = tensor(control.rest()).clamp(-self._bound, self._bound)
        self._absolute = torch.tensor(absolute, device=device)
        self._holds = self._absolute | torch.tensor(hands, device=device)
        self._mean: Tensor | None = None  # (B, H, A)
        self._last: Tensor | None = None  # (B, A), the action that led to the present state

    def _noise_scale(self, control: Control, arm: str | None = None) -> Tensor:
        """Factors (S, 1, A) of the samples' noise, from 1 down to the least; 0 for what is to stay.

        Args:
            control: meaning of an action's components.
            arm: the only one that is to move, and what belongs to no arm; None moves all.
        """
        samples, least = self.config.samples, self._least
        arm_of = [c.arm for c in control.channels for _ in range(c.start, c.stop)]
        free = torch.tensor([arm in (None, name) or not name for name in arm_of])
        sigma = torch.where(free, self._sigma.cpu(), 0.0).tolist()
        if self.config.geometric_scales:
            kept = samples - 1 - self._stop_samples  # the mean itself and the stop samples need no noise
            place = (torch.arange(samples, device=least.device) / max(kept - 1, 1)).clamp_max(1.0).unsqueeze(-1)
            scale = least.clamp_min(_FINEST) ** place
        else:
            place = torch.linspace(0.0, 1.0, samples, device=least.device).unsqueeze(-1)
            scale = 1.0 - place * (1.0 - least)
        c = self.config
        shares = c.single_arm_share, c.single_component_share, c.single_channel_share
        moves = sample_mask(control, sigma, samples, *shares)
        together = self._together.cpu()
        moves = torch.where(together.unsqueeze(1), together_mask(control, together), moves)  # whatever the shares say
        moves = moves & free
        return (scale * moves.to(device=scale.device, dtype=scale.dtype)).unsqueeze(1)

    @property
    def horizon(self) -> int:
        """Steps that a plan looks ahead."""
        return self.config.horizon

    def reset(self) -> None:
        """Forget the last plan."""
        self._mean = self._last = None

    @torch.no_grad()
    def plan(
        self,
        objective: Objective,
        generator: torch.Generator,
        batch: int = 1,
        last_action: Tensor | None = None,
        proposal: Tensor | None = None,
    ) -> Tensor:
        """Improved action sequences (B, H, A), started from the last plan shifted by one step.

        Args:
            objective: costs (B, S) of action sequences (B, S, H, A).
            generator: source of the noise.
            batch: B, environments planned for at once.
            last_action: actions (B, A) that led to the present state, where they are known.
            proposal: action sequences (B, H, A) to start from where they are cheaper.

        Raises:
            PwmGymError: a proposal of another shape.
        """
        self._last = None if last_action is None else last_action.clamp(-self._bound, self._bound)
        start = self._warm_start(batch)
        if proposal is not None:
            start = self._cheaper(start, proposal, objective)
        self._mean = self._improve(start, objective, generator)
        return self._mean

    def _cheaper(self, start: Tensor, proposal: Tensor, objective: Objective) -> Tensor:
        """Of two action sequences (B, H, A) the cheaper one of each environment."""
        if proposal.shape != start.shape:
            raise PwmGymError(f"proposal has shape {tuple(proposal.shape)}; expected {tuple(start.shape)}")
        both = torch.stack([start, proposal.clamp(-self._bound, self._bound)], 1)
        cheapest = objective(both).argmin(1)
        return both[torch.arange(len(both)), cheapest]

    @abstractmethod
    def _improve(self, mean: Tensor, objective: Objective, generator: torch.Generator) -> Tensor:
        """The next plan (B, H, A), sought around ``mean`` (B, H, A)."""

    def _warm_start(self, batch: int) -> Tensor:
        """The last plan one step on, its last action repeated; at first the robot stands still."""
        if self._mean is None or len(self._mean) != batch:
            still = self._rest.expand(batch, -1)
            if self._last is not None:
                still = torch.where(self._holds, self._last, still)
            return still.unsqueeze(1).repeat(1, self.config.horizon, 1)
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
        actions = (mean.unsqueeze(1) + spread * self._scale[-count:] * noise).clamp(-self._bound, self._bound)
        actions[:, -1] = mean
        for step in range(min(self._stop_samples, count // 4)):
            stopping = actions[:, -2 - step]
            stopping[:] = mean
            stopping[:, step:] = self._still(mean, step).unsqueeze(1)
        return actions

    def _still(self, mean: Tensor, step: int) -> Tensor:
        """Action (B, A) that stands still after ``step`` steps of ``mean`` (B, H, A)."""
        held = mean[:, max(step - 1, 0)]
        if step == 0 and self._last is not None:
            held = torch.where(self._absolute, self._last, held)
        return torch.where(self._holds, held, self._rest)

    def _noise(self, batch: int, generator: torch.Generator) -> Tensor:
        """Standard normal noise (B, S, H, A), correlated from step to step."""
        c = self.config
        noise = torch.randn(
            (batch, c.samples, c.horizon, self.action_size), generator=generator, device=self._sigma.device
        )
        for h in range(1, c.horizon):
            noise[:, :, h] = self._correlation * noise[:, :, h - 1] + self._fresh * noise[:, :, h]
        if self._mixing is not None:
            noise = noise @ self._mixing
        if self.config.together_share:
            noise[:, self._together] = noise[:, self._together][..., self._counterparts]
        return noise
