"""The paper's dynamics network: Point Transformer V3 with action tokens at its bottleneck (section 3)."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pwm_gym.dynamics.paper.ptv3.layers import MLP
from pwm_gym.dynamics.paper.ptv3.level import Level
from pwm_gym.dynamics.paper.ptv3.network import PointTransformer, PTv3Config
from pwm_gym.dynamics.paper.ptv3.serialization import merge_duplicates
from pwm_gym.dynamics.pointwise import PointwiseConfig, PointwiseModel, velocity_head
from pwm_gym.robots import Control
from pwm_gym.scene import Layout

__all__ = ["PaperConfig", "PaperModel", "SmallPaperConfig"]


@dataclass(frozen=True)
class PaperConfig(PTv3Config, PointwiseConfig):
    """Hyper-parameters of :class:`PaperModel` beside the backbone's; plain values, which JSON holds."""

    registers: int = 1
    """Learnable tokens beside the action's (paper: 0, 1 or 2 compared, 1 used)."""
    cross_layers: int = 3
    self_layers: int = 3
    bottleneck_heads: int = 8
    head_layers: int = 4
    """Linear layers from per-point features to velocities."""
    grid_size: float = 0.0035
    """Finest cell in metres. Chosen for the paper's 200-400 points at the bottleneck: with 300 points each on
    the Panda's hand, its fingers and a 4 cm cube nearby (ManiSkill's meshes, 20 random scenes), two poolings
    leave 300-324; 4 mm leaves about 250, 5 mm about 170."""
    bf16: bool = False
    """Run the network in bfloat16 (autocast)."""


@dataclass(frozen=True)
class SmallPaperConfig(PaperConfig):
    """The paper's architecture at a size that two CPU cores train in about an hour: same parts, fewer of each."""

    points: int = 64
    rigid: bool = True
    encoder_depths: tuple[int, ...] = (1, 1, 1)
    encoder_channels: tuple[int, ...] = (32, 64, 128)
    encoder_heads: tuple[int, ...] = (4, 4, 4)
    encoder_patches: tuple[int, ...] = (64, 48, 64)
    decoder_depths: tuple[int, ...] = (1, 1)
    decoder_channels: tuple[int, ...] = (64, 64)
    decoder_heads: tuple[int, ...] = (4, 4)
    decoder_patches: tuple[int, ...] = (64, 48)
    bottleneck_heads: int = 4
    cross_layers: int = 2
    self_layers: int = 2
    mlp_ratio: int = 2
    drop_path: float = 0.1
    grid_size: float = 0.01


class _Attention(nn.Module):
    """Pre-norm transformer layer: queries attend to a context, or to themselves, then an MLP."""

    def __init__(self, size: int, heads: int, config: PTv3Config, *, cross: bool) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(size)
        self.norm_context = nn.LayerNorm(size) if cross else None
        self.query = nn.Linear(size, size, bias=config.qkv_bias)
        self.key_value = nn.Linear(size, 2 * size, bias=config.qkv_bias)
        self.out = nn.Linear(size, size)
        self.norm_mlp = nn.LayerNorm(size)
        self.mlp = MLP(size, config.mlp_ratio)

    def forward(self, x: Tensor, context: Tensor | None = None, valid: Tensor | None = None) -> Tensor:
        """Features (B, M, C) of ``x`` (B, M, C); keys: ``context`` (B, K, C), or ``x`` where ``valid``.

        ``valid`` (B, 1, 1, M) is None where all are.
        """
        normed = self.norm(x)
        keys = normed if self.norm_context is None else self.norm_context(context)
        q = self.query(normed).unflatten(-1, (self.heads, -1)).transpose(1, 2)  # (B, heads, M, C / heads)
        k, v = self.key_value(keys).unflatten(-1, (2, self.heads, -1)).permute(2, 0, 3, 1, 4)
        attended = F.scaled_dot_product_attention(q, k, v, valid)
        x = x + self.out(attended.transpose(1, 2).flatten(2))
        return x + self.mlp(self.norm_mlp(x))


class _Conditioning(nn.Module):
    """Action and register tokens as keys and values of the points, then attention among a scene's points."""

    def __init__(self, size: int, action_size: int, config: PaperConfig) -> None:
        super().__init__()
        self.action = nn.Sequential(nn.Linear(action_size, size), nn.GELU(), nn.Linear(size, size))
        self.registers = nn.Parameter(torch.empty(config.registers, size))
        nn.init.trunc_normal_(self.registers, std=0.02)
        heads = config.bottleneck_heads
        self.cross = nn.ModuleList(_Attention(size, heads, config, cross=True) for _ in range(config.cross_layers))
        self.mix = nn.ModuleList(_Attention(size, heads, config, cross=False) for _ in range(config.self_layers))

    def forward(self, x: Tensor, level: Level, action: Tensor) -> Tensor:
        """Features (M, C) of ``x`` (M, C), the bottleneck tokens of all scenes, under ``action`` (B, A)."""
        scenes, most = len(level.sizes), max(level.sizes)
        rank = torch.arange(len(x), device=x.device) - level.starts[level.batch]
        dense = x.new_zeros(scenes, most, x.shape[1]).index_put((level.batch, rank), x)  # (B, M', C)
        valid = None
        if min(level.sizes) < most:
            valid = (torch.arange(most, device=x.device) < level.counts.unsqueeze(1))[:, None, None]
        token = self.action(action).unsqueeze(1)
        registers = self.registers.to(token.dtype).expand(scenes, -1, -1)
        context = torch.cat([token, registers], 1)  # (B, 1 + R, C)
        for layer in self.cross:
            dense = layer(dense, context)
        for layer in self.mix:
            dense = layer(dense, valid=valid)
        return dense[level.batch, rank]


class PaperModel(PointwiseModel):
    """The paper's world model: a Point Transformer V3 between points and velocities, actions at its bottleneck.

    The grid is centred at the mean of the end effectors' points, so that motion over the table does not change the
    order of the points. Points with equal features are one token.
    """

    def __init__(self, layout: Layout, control: Control | None = None, config: PaperConfig | None = None) -> None:
        config = config or PaperConfig()
        super().__init__(layout, control, config)
        self.backbone = PointTransformer(self.channels, config)
        self.conditioning = _Conditioning(config.encoder_channels[-1], self.action_size, config)
        self.head = velocity_head(config.decoder_channels[0], config.head_layers)

    def network(self, rows: Tensor, positions: Tensor, action: Tensor) -> Tensor:
        """Scaled velocities (B, N, 3) of features (B, N, C), points (B, N, 3) and actions (B, A)."""
        token, place = merge_duplicates(rows.detach())
        batch = token.div(rows.shape[1], rounding_mode="floor")
        level = self.backbone.level(positions.flatten(0, 1)[token], batch, len(rows), self.config.grid_size)
        autocast = torch.autocast(rows.device.type, torch.bfloat16) if self.config.bf16 else nullcontext()
        with autocast:
            encoded = self.backbone.encode(level, rows.flatten(0, 1).index_select(0, token))
            latents = self.conditioning(encoded.features[-1], encoded.levels[-1], action)
            moved = self.head(self.backbone.decode(encoded, latents))  # (T, 3)
        return moved.to(rows.dtype).index_select(0, place).view_as(positions)
