"""ParticleFormer* (paper, appendix "Baselines"): three transformer layers, after Huang et al. (2025)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.dynamics.pointwise import PointwiseConfig, PointwiseModel, velocity_head
from pwm_gym.robots import Control
from pwm_gym.scene import Layout

__all__ = ["ParticleFormer", "ParticleFormerConfig"]


@dataclass(frozen=True)
class ParticleFormerConfig(PointwiseConfig):
    """Hyper-parameters of :class:`ParticleFormer`; only the number of layers is the paper's."""

    entity_features: bool = True
    """A point tells its entity."""
    width: int = 128
    """Channels of a point."""
    layers: int = 3
    """Self-attention layers."""
    heads: int = 4
    """Attention heads."""
    mlp_ratio: int = 4
    """Hidden width of a layer's MLP over ``width``."""
    head_layers: int = 4
    """Linear layers from per-point features to velocities."""


class ParticleFormer(PointwiseModel):
    """Points and an action token attend to each other; each point gives its velocity."""

    def __init__(
        self,
        layout: Layout,
        control: Control | None = None,
        config: ParticleFormerConfig | None = None,
    ) -> None:
        config = config or ParticleFormerConfig()
        super().__init__(layout, control, config)
        width = config.width
        self.point = nn.Sequential(nn.Linear(self.channels, width), nn.GELU(), nn.Linear(width, width))
        self.action = nn.Sequential(nn.Linear(self.action_size, width), nn.GELU(), nn.Linear(width, width))
        self.layers = nn.ModuleList(
            nn.TransformerEncoderLayer(
                width,
                config.heads,
                config.mlp_ratio * width,
                dropout=0.0,
                activation=F.gelu,
                batch_first=True,
                norm_first=True,
            )
            for _ in range(config.layers)
        )
        self.head = velocity_head(width, config.head_layers)

    def network(self, rows: Tensor, positions: Tensor, action: Tensor) -> Tensor:
        """Scaled velocities (B, N, 3) of features (B, N, C) and actions (B, A)."""
        tokens = torch.cat([self.point(rows), self.action(action).unsqueeze(1)], 1)
        for layer in self.layers:
            tokens = layer(tokens)
        return self.head(tokens[:, :-1])
