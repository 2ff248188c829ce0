"""Noise of action sequences: settings per kind of channel, resolved to the components of a robot's actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Channel, Control

__all__ = ["ActionNoise", "ComponentNoise", "NoiseConfig", "power_law_noise"]

_GOLDEN = 0.6180339887498949  # multiples of it, modulo 1, are spread evenly however many there are


@dataclass(frozen=True)
class NoiseConfig:
    """Noise of the components of one kind of channel.

    Raises:
        PwmGymError: a setting that cannot be.
    """

    sigma: tuple[float, ...] = (0.3,)
    """Standard deviation in action units: one for all components of a channel, or one for each. Components without
    noise keep their mean."""
    correlation: float = 0.7
    """Correlation from one step to the next; 0 is white."""
    min_noise_scale: float = 0.2
    """The samples' noise is scaled from 1 down to this, so that some search wide and some refine."""
    bound: float = 1.0
    """Largest size of a component; at most 1."""
    synergy: float = 0.0
    """Correlation between the components of a channel: fingers of a hand that bend together, each a little its own
    way."""

    def __post_init__(self) -> None:
        """Check each value."""
        if not self.sigma or not all(s >= 0.0 for s in self.sigma):
            raise PwmGymError(f"sigma={self.sigma}; expected values of at least 0")
        for name in ("correlation", "min_noise_scale", "synergy"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise PwmGymError(f"{name}={getattr(self, name)}; expected 0 to 1")
        if not 0.0 < self.bound <= 1.0:
            raise PwmGymError(f"bound={self.bound}; expected more than 0 and at most 1")

    def sigmas(self, channel: Channel) -> tuple[float, ...]:
        """Standard deviation of each of a channel's components.

        Raises:
            PwmGymError: the channel has another number of components.
        """
        count = channel.stop - channel.start
        if len(self.sigma) not in (1, count):
            raise PwmGymError(f"{channel.kind} sigma has {len(self.sigma)} values; expected 1 or {count}")
        return self.sigma * count if len(self.sigma) == 1 else self.sigma


@dataclass(frozen=True)
class ActionNoise:
    """Noise of each kind of channel; the defaults of arms and grippers are tuned on PickCube's validation seeds."""

    translation: NoiseConfig = NoiseConfig()
    rotation: NoiseConfig = NoiseConfig(sigma=(0.0, 0.0, 0.3))
    """About the base's x, y and z: on a table a tool that points down has to turn about z alone."""
    yaw: NoiseConfig = NoiseConfig()
    gripper: NoiseConfig = NoiseConfig(sigma=(0.7,), correlation=0.97, min_noise_scale=1.0)
    """Its correlation is high: one step's opening drops what is held, which would hide all other differences between
    the samples. Only wide noise shuts it."""
    finger: NoiseConfig = NoiseConfig(correlation=0.95, min_noise_scale=0.5)
    """Fingers close together and slowly, as a gripper does, by targets that are finer than open and shut."""
    joint: NoiseConfig = NoiseConfig()

    @classmethod
    def uniform(cls, noise: NoiseConfig) -> ActionNoise:
        """The same noise for every kind of channel."""
        return cls(**{f.name: noise for f in fields(cls)})

    def resolve(self, control: Control) -> ComponentNoise:
        """Values of each component of an action.

        Raises:
            PwmGymError: a channel has no component, or other ones than the settings say.
        """
        if not control.size:
            raise PwmGymError("the control has no channels; expected at least one to plan with")
        kinds = [(c, getattr(self, c.kind)) for c in control.channels]
        spread = {name: [] for name in ("correlation", "min_noise_scale", "bound")}  # type: dict[str, list[float]]
        for channel, noise in kinds:
            for name, values in spread.items():
                values += [getattr(noise, name)] * (channel.stop - channel.start)
        return ComponentNoise(
            synergies=tuple((channel.start, channel.stop, noise.synergy) for channel, noise in kinds if noise.synergy),
            sigma=tuple(s for channel, noise in kinds for s in noise.sigmas(channel)),
            **{name: tuple(values) for name, values in spread.items()},
        )


@dataclass(frozen=True)
class ComponentNoise:
    """Noise of each component (A,) of an action."""

    sigma: tuple[float, ...]
    correlation: tuple[float, ...]
    min_noise_scale: tuple[float, ...]
    bound: tuple[float, ...]
    synergies: tuple[tuple[int, int, float], ...] = ()
    """First component, the one behind the last, and correlation of components that move together."""

    def mixing(self) -> Tensor | None:
        """Symmetric matrix (A, A) that makes white noise (..., A) of components that move together; None if none do.

        It is the square root of their correlations, so that each component's standard deviation stays 1.
        """
        if not self.synergies:
            return None
        matrix = torch.eye(len(self.sigma))
        for start, stop, together in self.synergies:
            count, own = stop - start, (1.0 - together) ** 0.5
            common = ((1.0 + (count - 1) * together) ** 0.5 - own) / count
            matrix[start:stop, start:stop] = own * torch.eye(count) + common
        return matrix


def counterparts(control: Control) -> list[int]:
    """For each component of an action (A,) that of the first arm which means the same; its own where there is none."""
    found = list(range(control.size))
    if len(control.arms) < 2:
        return found
    first = {c.kind: c for c in control.of_arm(control.arm_names[0])}
    for channel in control.channels:
        same = first.get(channel.kind) if channel.arm else None
        if same is not None and same.stop - same.start == channel.stop - channel.start:
            found[channel.slice] = range(same.start, same.stop)
    return found


def share_mask(samples: int, share: float, step: int) -> Tensor:
    """Bool (S,): a ``share`` of the samples, spread evenly; another ``step`` chooses others."""
    return torch.arange(samples, dtype=torch.float64) * _GOLDEN * step % 1.0 < share


def together_mask(control: Control, together: Tensor) -> Tensor:
    """Which components (S, A), bool, samples perturb in which all arms go the same way.

    Their translations, in every other such sample along one axis alone, each in turn: hands that turned alike, each
    about itself, would lose what they hold. All components of robots that have no translations.
    """
    axis_of = [-1] * control.size
    for channel in control.of_kind("translation"):
        axis_of[channel.slice] = range(channel.stop - channel.start)
    axes, count = torch.tensor(axis_of), max(axis_of) + 1
    if count == 0:
        return together.unsqueeze(1).expand(-1, control.size)
    turn = together.long().cumsum(0)  # how many of them there were
    one, chosen = turn % 2 == 0, turn // 2 % count
    moved = torch.where(one.unsqueeze(1), axes == chosen.unsqueeze(1), axes >= 0)
    return moved & together.unsqueeze(1)


def sample_mask(
    control: Control,
    sigma: Sequence[float],
    samples: int,
    single_arm_share: float,
    single_component_share: float,
    single_channel_share: float = 0.0,
) -> Tensor:
    """Which components (S, A), bool, each sample perturbs; the others follow the last plan.

    Args:
        control: says which arm each component belongs to; components of no arm are always perturbed.
        sigma: noise of each component (A,); those without any are nobody's turn.
        samples: S.
        single_arm_share: share of the samples that perturb one arm alone, each arm in turn.
        single_component_share: share of the samples that perturb one component alone, each in turn, whatever the other
            shares say.
        single_channel_share: share of the other samples that perturb one channel alone, each in turn, whatever the
            share of single arms says.
    """
    names = control.arm_names
    channels = [c for c in control.channels if any(sigma[c.slice])]
    arm_of = [names.index(c.arm) if c.arm else -1 for c in control.channels for _ in range(c.start, c.stop)]
    channel_of = [channels.index(c) if c in channels else -1 for c in control.channels for _ in range(c.start, c.stop)]
    noisy = [k for k, value in enumerate(sigma) if value > 0.0]
    component_of = [noisy.index(k) if k in noisy else -1 for k in range(len(sigma))]
    moved, _ = _single_mask(arm_of, len(names), samples, single_arm_share, step=1)
    finer = (
        _single_mask(channel_of, len(channels), samples, single_channel_share, step=5),
        _single_mask(component_of, len(noisy), samples, single_component_share, step=2),
    )
    for mask, alone in finer:
        moved = torch.where(alone.unsqueeze(1), mask, moved)
    return moved


def _single_mask(owner: list[int], count: int, samples: int, share: float, step: int) -> tuple[Tensor, Tensor]:
    """Components (S, A) that samples perturb, a ``share`` (S,) of which those of one owner alone; -1 belongs to all.

    ``step`` chooses which samples those are: wide and fine ones have their share each.
    """
    place = torch.arange(samples, dtype=torch.float64) * _GOLDEN * step % 1.0
    single = share_mask(samples, share, step) & (count > 1)
    chosen = (place / max(share, 1e-9) * count).long().clamp(max=count - 1)  # (S,)
    owners = torch.tensor(owner)
    return ~single[:, None] | (owners == chosen[:, None]) | (owners < 0), single


def power_law_noise(shape: tuple[int, ...], beta: float, generator: torch.Generator) -> Tensor:
    """Standard normal noise (..., H, A) whose power falls with the frequency along H as ``1 / f ** beta``.

    Timmer and Koenig's construction (1995), as iCEM samples actions; a beta of 0 is white.
    """
    *front, horizon, size = shape
    frequencies = torch.fft.rfftfreq(horizon, device=generator.device).clamp_min(1.0 / horizon)
    scale = frequencies.pow(-0.5 * beta)
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
