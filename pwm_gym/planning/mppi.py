"""Model predictive path integral control (Williams et al., 2017), as the paper plans with it (section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError
from pwm_gym.planning.noise import ActionNoise, NoiseConfig
from pwm_gym.planning.sampling import Objective, SamplingConfig, SamplingPlanner
from pwm_gym.robots import Control

__all__ = ["MPPI", "MPPIConfig"]


@dataclass(frozen=True)
class MPPIConfig(SamplingConfig):
    """Settings of MPPI. The defaults are tuned on PickCube's planning-validation seeds."""

    temperature: float = 0.05
    """The paper's lambda: the cost difference that makes a sequence e times less likely."""
    relative: bool = True
    """Whether the temperature is in units of the elites' cost spread."""
    in_turn: bool = False
    """Whether each iteration perturbs one arm alone, each arm in turn, after one for all where arms also go together:
    what is good for one hand is then not lost with what is bad for another."""

    def check(self) -> None:
        """Refuse what cannot be.

        Raises:
            PwmGymError: naming the setting and what was expected.
        """
        super().check()
        if not self.temperature > 0.0:
            raise PwmGymError(f"temperature={self.temperature}; expected more than 0")

    @classmethod
    def fine(cls) -> MPPIConfig:
        """Samples that refine finely, and one component at a time: for tasks of millimetres.

        They turn the hand about every axis: it may have been tilted, and has to be set upright again.
        """
        noise = ActionNoise()
        moves = replace(noise.translation, min_noise_scale=0.03)
        turns = replace(noise.rotation, sigma=(0.1, 0.1, 0.3), min_noise_scale=0.03)
        fine = replace(noise, translation=moves, rotation=turns)
        return cls(noise=fine, single_component_share=0.45, geometric_scales=True)

    @classmethod
    def pair(cls) -> MPPIConfig:
        """As :meth:`fine`, for several arms whose hands hold one thing together: they keep their posture by themselves,
        go 3 cm a step at most, in some of the samples the same way; fingers bend together.
        """
        fine = cls.fine()
        moves = replace(fine.noise.translation, bound=0.3)
        turns = replace(fine.noise.rotation, sigma=(0.0, 0.0, 0.4))
        fingers = replace(fine.noise.finger, sigma=(0.5,), correlation=0.97, min_noise_scale=0.03, synergy=0.8)
        noise = replace(fine.noise, translation=moves, rotation=turns, finger=fingers)
        return replace(
            fine,
            noise=noise,
            single_arm_share=0.4,
            together_share=0.3,
            single_channel_share=0.5,
            single_component_share=0.2,
            posture=True,
        )

    @classmethod
    def hands(cls) -> MPPIConfig:
        """As :meth:`pair`, for hands of which each has something of its own to do: planned one after the other."""
        return replace(
            cls.pair().resize(60),
            iterations=2,
            in_turn=True,
            single_arm_share=0.0,
            together_share=0.0,
            single_channel_share=0.4,
            single_component_share=0.4,
        )

    @classmethod
    def paper(cls, horizon: int = 10) -> MPPIConfig:
        """The paper's table; sigma 5 on actions in [-1, 1] saturates most samples."""
        return cls(
            samples=200,
            horizon=horizon,
            elites=64,
            temperature=0.7,
            relative=False,
            noise=ActionNoise.uniform(NoiseConfig(sigma=(5.0,), correlation=0.0, min_noise_scale=1.0)),
            stop_samples=0,
            single_arm_share=0.0,
        )


class MPPI(SamplingPlanner[MPPIConfig]):
    """The cheapest samples' mean, each weighted by ``exp(-cost / temperature)``."""

    def __init__(
        self, config: MPPIConfig, control: Control, device: torch.device | str = "cpu", fixed: Sequence[int] = ()
    ) -> None:
        super().__init__(config, control, device, fixed)
        arms = control.arm_names if config.in_turn else ()
        scales = [self._noise_scale(control, arm) for arm in arms]
        self._scales = [self._scale, *scales] if config.together_share or not arms else scales  # of each iteration

    def _improve(self, mean: Tensor, objective: Objective, generator: torch.Generator) -> Tensor:
        for k in range(self.config.iterations):
            self._scale = self._scales[k % len(self._scales)]
            actions = self._sample(mean, self._sigma, self._noise(len(mean), generator))  # (B, S, H, A)
            mean = self._average(actions, objective(actions))
        return mean

    def _average(self, actions: Tensor, costs: Tensor) -> Tensor:
        """Elites' weighted mean (B, H, A)."""
        best, index = costs.topk(self.config.elites, dim=1, largest=False)  # (B, K)
        scale = self.config.temperature
        if self.config.relative:
            spread = (best[:, -1:] - best[:, :1]).clamp_min(1e-6)
            weights = torch.softmax(-(best - best[:, :1]) / (scale * spread), 1)
        else:
            weights = torch.softmax(-(best - best[:, :1]) / scale, 1)
        elites = actions.gather(1, index[..., None, None].expand(-1, -1, *actions.shape[2:]))
        return (weights[..., None, None] * elites).sum(1).clamp(-1.0, 1.0)  # rounding may leave the limits
