"""The paper's dynamics network: Point Transformer V3 with action tokens at its bottleneck (section 3)."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pwm_gym.dynamics.ptv3.layers import MLP
from pwm_gym.dynamics.ptv3.level import Level
from pwm_gym.dynamics.ptv3.network import PointTransformer, PTv3Config
from pwm_gym.dynamics.ptv3.serialization import merge_duplicates
from pwm_gym.robots import Control
from pwm_gym.scene import Layout, PointState, State

__all__ = ["PaperConfig", "PaperModel"]

_FEATURES = 9  # position, velocity, previous velocity


@dataclass(frozen=True)
class PaperConfig(PTv3Config):
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
    position_scale: float = 0.1
    """Metres that the network sees as 1."""
    velocity_scale: float = 0.01
    """Metres a step that the network sees, and gives, as 1."""
    bf16: bool = False
    """Run the network in bfloat16 (autocast)."""


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


class PaperModel(nn.Module):
    """The paper's world model: per-point velocities of the next step from [x_t, v_t, v_{t-1}] and an action.

    The network sees distances to the mean of the end effectors' points, except that the height feature stays
    that of the robot base's frame: table and gravity depend on it. The grid is centred at the same mean, so
    that motion over the table does not change the order of the points. Points with equal features are one
    token.
    """

    def __init__(
        self, layout: Layout, action_size: int, control: Control | None = None, config: PaperConfig | None = None
    ) -> None:
        super().__init__()
        self.layout, self.control = layout, control or Control()
        self.action_size = action_size
        self.config = config = config or PaperConfig()
        ids = [i for e in layout if e.effector for i in range(e.start, e.stop)]
        self.effectors: Tensor
        self.register_buffer("effectors", torch.tensor(ids or list(range(layout.points))), persistent=False)
        self.backbone = PointTransformer(_FEATURES, config)
        self.conditioning = _Conditioning(config.encoder_channels[-1], action_size, config)
        self.head = _head(config.decoder_channels[0], config.head_layers)

    def prepare(self, state: State) -> PointState:
        """The state as points."""
        return PointState.of(state)

    def step(self, state: State, action: Tensor) -> PointState:
        """State (B,) one control step after ``action`` (B, A) in [-1, 1]."""
        now = self.prepare(state)
        points = now.points()
        return now.advance(points + self(points, now.velocity(), now.previous_velocity(), action))

    def forward(self, points: Tensor, velocity: Tensor, previous_velocity: Tensor, action: Tensor) -> Tensor:
        """Velocities of the next step (B, N, 3) in metres a step.

        Args:
            points: x_t (B, N, 3) in metres.
            velocity: v_t (B, N, 3) in metres a step.
            previous_velocity: v_{t-1} (B, N, 3).
            action: a_t (B, A) in [-1, 1].
        """
        centred = self._centre(points)
        config = self.config
        position = torch.cat([centred[..., :2], points[..., 2:]], -1) / config.position_scale
        motion = torch.cat([velocity, previous_velocity], -1) / config.velocity_scale
        rows = torch.cat([position, motion], -1)  # (B, N, 9)
        token, place = merge_duplicates(rows.detach())
        batch = token.div(points.shape[1], rounding_mode="floor")
        level = self.backbone.level(centred.flatten(0, 1)[token], batch, len(points), config.grid_size)
        autocast = torch.autocast(points.device.type, torch.bfloat16) if config.bf16 else nullcontext()
        with autocast:
            encoded = self.backbone.encode(level, rows.flatten(0, 1).index_select(0, token))
            latents = self.conditioning(encoded.features[-1], encoded.levels[-1], action)
            moved = self.head(self.backbone.decode(encoded, latents))  # (T, 3)
        moved = moved.to(points.dtype).index_select(0, place)  # (B * N, 3)
        return moved.view_as(points) * config.velocity_scale

    def _centre(self, points: Tensor) -> Tensor:
        """``points`` (B, N, 3) as seen from the mean of the end effectors' points."""
        # In float64 the mean does not depend on the order of the points, and so neither do their cells.
        mean = points[:, self.effectors].double().mean(1, keepdim=True)
        return points - mean.to(points.dtype)


def _head(size: int, layers: int) -> nn.Sequential:
    """Layer norm and an MLP (..., size) to (..., 3); its first outputs are small: untrained, little moves."""
    hidden = [m for _ in range(layers - 1) for m in (nn.Linear(size, size), nn.GELU())]
    last = nn.Linear(size, 3)
    nn.init.normal_(last.weight, std=1e-2)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.LayerNorm(size), *hidden, last)
