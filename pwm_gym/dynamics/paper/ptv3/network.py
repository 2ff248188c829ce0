"""Point Transformer V3 (Wu et al. 2024), a U-Net over grid levels, with 3DPWM's hyper-parameters."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise

import torch
from torch import Tensor, nn

from pwm_gym.dynamics.paper.ptv3.layers import Block, GridPool, GridUnpool
from pwm_gym.dynamics.paper.ptv3.level import Level
from pwm_gym.dynamics.paper.ptv3.serialization import CURVES
from pwm_gym.errors import PwmGymError, unknown_name

__all__ = ["Encoded", "PTv3Config", "PointTransformer"]


@dataclass(frozen=True)
class PTv3Config:
    """Hyper-parameters of the network (paper, table "Hyperparameter values"); stages are listed finest first.

    How the paper is read:

    - Its text names four encoder stages, its table three. The table is taken.
    - Positional encoding ``[CPE, RPE, CPE, RPE]`` against patch sizes ``[256, 48, 256]`` and ``[256, 48]``:
      the text says that RPE is on in alternating encoder and decoder blocks, with patches of 48 where it is
      on and 256 where it is off. In the order in which the stages run (encoder 1, 2, 3, decoder 2, 1) the
      patches are 256, 48, 256, 48, 256, hence CPE, RPE, CPE, RPE and again CPE. A stage has one or the other,
      not both.
    - Drop path 0.3 is the largest rate: it rises linearly from the finest stage to the coarsest and falls
      again in the decoder, as in Point Transformer V3.
    """

    curves: tuple[str, ...] = ("z", "z-trans", "hilbert", "hilbert-trans")
    """Serialisations; successive blocks of the whole network take successive ones (shift order)."""
    shuffle_orders: bool = True
    """In training, shuffle the curves of each level."""
    encoder_depths: tuple[int, ...] = (2, 2, 2)
    """Blocks in each stage."""
    encoder_channels: tuple[int, ...] = (32, 128, 256)
    encoder_heads: tuple[int, ...] = (8, 8, 8)
    encoder_patches: tuple[int, ...] = (256, 48, 256)
    """Tokens that attend to each other."""
    encoder_positions: tuple[str, ...] = ("cpe", "rpe", "cpe")
    """Convolution before attention (``cpe``) or relative bias inside it (``rpe``)."""
    decoder_depths: tuple[int, ...] = (2, 2)
    decoder_channels: tuple[int, ...] = (128, 256)
    decoder_heads: tuple[int, ...] = (8, 8)
    decoder_patches: tuple[int, ...] = (256, 48)
    decoder_positions: tuple[str, ...] = ("cpe", "rpe")
    mlp_ratio: int = 4
    qkv_bias: bool = True
    drop_path: float = 0.3
    rpe_reach: int = 16
    """Distance in cells beyond which the relative bias is constant (not stated in the paper)."""
    grid_bits: int = 12
    """Bits of a grid coordinate: 4096 cells an axis."""

    def __post_init__(self) -> None:
        for f in fields(self):  # JSON has lists
            if isinstance(getattr(self, f.name), list):
                object.__setattr__(self, f.name, tuple(getattr(self, f.name)))
        self._check_stages("encoder", len(self.encoder_depths))
        self._check_stages("decoder", len(self.encoder_depths) - 1)
        for curve in self.curves:
            if curve not in CURVES:
                raise unknown_name("curve", curve, tuple(CURVES))
        if not len(self.encoder_depths) <= self.grid_bits <= 16:
            raise PwmGymError(f"grid_bits={self.grid_bits}; expected {len(self.encoder_depths)} to 16")

    def _check_stages(self, side: str, stages: int) -> None:
        for name in ("depths", "channels", "heads", "patches", "positions"):
            values = getattr(self, f"{side}_{name}")
            if len(values) != stages:
                raise PwmGymError(f"{side}_{name}={values}; expected {stages} stages")
        for size, heads in zip(getattr(self, f"{side}_channels"), getattr(self, f"{side}_heads"), strict=True):
            if size % heads:
                raise PwmGymError(f"{side}_channels has {size}, which {heads} heads do not divide")
        for position in getattr(self, f"{side}_positions"):
            if position not in ("cpe", "rpe"):
                raise unknown_name("position encoding", position, ("cpe", "rpe"))


@dataclass(frozen=True, eq=False)
class Encoded:
    """What the encoder leaves for the decoder, finest level first."""

    levels: list[Level]
    parents: list[Tensor]
    """Coarse token (T,) of each token, for every level but the last."""
    features: list[Tensor]
    """Features (T, C) of each level; the last are the bottleneck's latents."""


class Stage(nn.ModuleList):
    """Blocks at one level, one after the other."""

    def forward(self, x: Tensor, level: Level) -> Tensor:
        """Features (T, C) of ``x`` (T, C)."""
        for block in self:
            x = block(x, level)
        return x


class PointTransformer(nn.Module):
    """U-Net of Point Transformer V3 blocks: (T, in_channels) to (T, decoder_channels[0])."""

    def __init__(self, in_channels: int, config: PTv3Config | None = None) -> None:
        super().__init__()
        self.config = config = config or PTv3Config()
        channels = config.encoder_channels
        # A linear stem: neighbourhoods enter with the first block's convolution.
        self.stem = nn.Sequential(nn.Linear(in_channels, channels[0]), nn.LayerNorm(channels[0]), nn.GELU())
        depths = config.encoder_depths
        self.encoder = nn.ModuleList(self._stage("encoder", i, sum(depths[:i])) for i in range(len(depths)))
        self.pools = nn.ModuleList(GridPool(a, b) for a, b in pairwise(channels))
        outs = (*config.decoder_channels, channels[-1])
        coarse_first = range(len(depths) - 2, -1, -1)
        self.unpools = nn.ModuleList(GridUnpool(outs[i + 1], channels[i], outs[i]) for i in coarse_first)
        self.decoder = nn.ModuleList(
            self._stage("decoder", i, sum(depths) + sum(config.decoder_depths[i + 1 :])) for i in coarse_first
        )

    def _stage(self, side: str, i: int, first: int) -> Stage:
        """Blocks of stage ``i`` of a side; the first of them takes curve ``first``."""
        config = self.config
        depths, channels, heads, patches, positions = (
            getattr(config, f"{side}_{name}") for name in ("depths", "channels", "heads", "patches", "positions")
        )
        before = sum(depths[:i])
        rates = torch.linspace(0, config.drop_path, sum(depths)).tolist()[before : before + depths[i]]
        if side == "decoder":
            rates.reverse()
        return Stage(
            Block(
                channels[i],
                heads[i],
                patches[i],
                position=positions[i],
                reach=config.rpe_reach,
                ratio=config.mlp_ratio,
                bias=config.qkv_bias,
                drop=rate,
                curve=first + j,
            )
            for j, rate in enumerate(rates)
        )

    def level(self, points: Tensor, batch: Tensor, scenes: int, grid_size: float) -> Level:
        """Finest level of ``points`` (T, 3), metres from their scene's centre, sorted by ``batch`` (T,)."""
        return Level.build(points, batch, scenes, grid_size, self.config.curves, self.config.grid_bits)

    def encode(self, level: Level, features: Tensor) -> Encoded:
        """Levels and features from the finest to the bottleneck, of ``features`` (T, in_channels)."""
        shuffle = self.training and self.config.shuffle_orders
        out = Encoded([level.shuffle() if shuffle else level], [], [])
        x = self.stem(features)
        for i, stage in enumerate(self.encoder):
            if i > 0:
                level, parent = out.levels[-1].pool()
                out.levels.append(level.shuffle() if shuffle else level)
                out.parents.append(parent)
                x = self.pools[i - 1](x, parent, len(level.batch))
            x = stage(x, out.levels[-1])
            out.features.append(x)
        return out

    def decode(self, encoded: Encoded, latents: Tensor) -> Tensor:
        """Features (T, decoder_channels[0]) at the finest level from ``latents`` (M, C) at the bottleneck."""
        x = latents
        for i, (unpool, stage) in enumerate(zip(self.unpools, self.decoder, strict=True)):
            j = len(encoded.parents) - 1 - i
            x = unpool(x, encoded.parents[j], encoded.features[j])
            x = stage(x, encoded.levels[j])
        return x

    def forward(self, level: Level, features: Tensor) -> Tensor:
        """Features (T, decoder_channels[0]) of ``features`` (T, in_channels)."""
        encoded = self.encode(level, features)
        return self.decode(encoded, encoded.features[-1])
