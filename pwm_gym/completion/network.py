"""The completion network (paper, appendix, "Point Completion" and its table): encoder, seed generator, decoder.

Its frame is the viewer's: the origin is the middle of the partial cloud, z points away from the camera, and lengths are
in units of the partial cloud's size. What is hidden then lies behind what is seen, whatever the object's orientation.
Input clouds are in the order of farthest-point sampling, so that a prefix is a coarser cloud and no layer samples anew.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.completion.neighbours import gather_points, nearest_points
from pwm_gym.errors import PwmGymError, look_up

__all__ = ["SIZES", "CompletionConfig", "CompletionNet", "get_size"]

_FIRST = 2e-3  # standard deviation of the weights that move points, before training


@dataclass(frozen=True)
class CompletionConfig:
    """Sizes of the network; the defaults are the paper's table.

    Where the table is silent: points of the encoder's stages, neighbours, and that the decoder starts from the seeds
    together with as many points of the input (as SeedFormer does, Zhou et al., 2022).
    """

    points: tuple[int, ...] = (2048, 512, 256, 128)
    """Input points of each stage of the encoder, which are prefixes of the input; the last are its tokens."""
    channels: tuple[int, ...] = (32, 64, 128, 256)
    """Channels of the encoder's stages."""
    neighbours: int = 16
    """Nearest points that a stage of the encoder reads."""
    features: int = 512
    """Channels of the global feature."""
    blocks: int = 4
    """Transformer blocks of the seed generator."""
    heads: int = 8
    """Their attention heads."""
    width: int = 384
    """Their channels."""
    seeds: int = 2
    """Seeds of each token: the seed generator's upsampling factor."""
    seed_channels: int = 256
    """Channels of a seed."""
    kept: int = 256
    """Input points that the decoder starts from, beside the seeds."""
    factors: tuple[int, ...] = (2, 2, 2)
    """The decoder's upsampling factors."""
    hidden: int = 64
    """The decoder's channels."""
    sources: int = 8
    """Nearest seeds and tokens that each of the decoder's points reads."""

    def __post_init__(self) -> None:
        """Check what the network's parts expect of each other.

        Raises:
            PwmGymError: stages that do not shrink, or do not match their channels.
        """
        if len(self.points) != len(self.channels):
            raise PwmGymError(f"{len(self.points)} stages with {len(self.channels)} channels; expected one each")
        if list(self.points) != sorted(self.points, reverse=True) or self.points[-1] < self.sources:
            raise PwmGymError(f"points={self.points}; expected fewer in each stage, at least {self.sources}")
        if self.heads < 1 or self.width % self.heads:
            raise PwmGymError(f"width={self.width}; expected a multiple of heads={self.heads}")

    @property
    def levels(self) -> tuple[int, ...]:
        """Points of each of the decoder's levels, the first before any upsampling."""
        counts = [self.points[-1] * self.seeds + self.kept]
        for factor in self.factors:
            counts.append(counts[-1] * factor)
        return tuple(counts)


SIZES: dict[str, CompletionConfig] = {
    "paper": CompletionConfig(),
    "compact": CompletionConfig(
        points=(512, 256, 128, 64),
        channels=(32, 64, 96, 128),
        neighbours=12,
        features=256,
        heads=4,
        width=128,
        seed_channels=128,
        kept=128,
        hidden=48,
        sources=6,
    ),
}
"""Name -> sizes; "compact" trains on two CPU cores."""


def get_size(name: str) -> CompletionConfig:
    """The sizes called ``name``.

    Raises:
        UnknownNameError: listing the known ones.
    """
    return look_up("size of the completion network", name, SIZES)


class CompletionNet(nn.Module):
    """Completes clouds: partial (B, n, 3) in, levels of complete ones out, coarse to fine."""

    def __init__(self, config: CompletionConfig) -> None:
        super().__init__()
        self.config = c = config
        before = (0, *c.channels[:-1])
        self.encoder = nn.ModuleList(_Stage(a, b, c.neighbours) for a, b in zip(before, c.channels, strict=True))
        self.pool = _mlp(c.channels[-1], c.features, c.features)
        self.token = nn.Linear(c.channels[-1], c.width)
        self.place = _mlp(3, c.width, c.width)
        self.blocks = nn.ModuleList(
            nn.TransformerEncoderLayer(c.width, c.heads, 4 * c.width, 0.0, F.gelu, batch_first=True, norm_first=True)
            for _ in range(c.blocks)
        )
        self.summary = nn.Linear(c.features, c.width)
        self.generate = _mlp(c.width, 2 * c.width, c.seeds * c.seed_channels)
        self.move = _mlp(c.seed_channels + c.features, c.seed_channels, 3)
        self.source = nn.Linear(c.width, c.seed_channels)
        self.decoder = nn.ModuleList(
            _Upsample(factor, c.seed_channels, c.features, c.hidden, c.sources, first=k == 0)
            for k, factor in enumerate(c.factors)
        )
        self.doubt = _mlp(c.features + c.seed_channels, c.features, 1)
        for name, value in self.named_parameters():
            if name.endswith("move.2.weight"):
                nn.init.normal_(value, std=_FIRST)  # at first it gives back what it sees
            elif name.endswith("move.2.bias"):
                nn.init.zeros_(value)

    def forward(self, partial: Tensor, steps: int | None = None) -> tuple[list[Tensor], Tensor]:
        """Complete clouds.

        Args:
            partial: (B, n, 3) in the viewer's frame, in the order of farthest-point sampling; n is the first stage's.
            steps: of the decoder; None takes all.

        Returns:
            Clouds (B, m, 3) of each level: the seeds, then what the decoder starts from and its steps. And the
            logarithm (B,) of the expected Chamfer distance of the last one.
        """
        c = self.config
        features, tokens = None, partial
        for stage, count in zip(self.encoder, c.points, strict=True):
            tokens, features = stage(tokens, features, tokens[:, :count])
        whole = self.pool(features).amax(1)  # (B, features)
        x = self.token(features) + self.place(tokens) + self.summary(whole).unsqueeze(1)
        for block in self.blocks:
            x = block(x)
        made = self.generate(x).unflatten(-1, (c.seeds, c.seed_channels)).flatten(1, 2)  # (B, T seeds, C)
        context = whole.unsqueeze(1).expand(-1, made.shape[1], -1)
        seeds = tokens.repeat_interleave(c.seeds, 1) + self.move(torch.cat([made, context], -1))
        where = torch.cat([seeds, tokens], 1)
        what = torch.cat([made, self.source(x)], 1)
        cloud, carried = torch.cat([seeds, partial[:, : c.kept]], 1), None
        clouds = [seeds, cloud]
        for layer in self.decoder[:steps]:
            cloud, carried = layer(cloud, carried, where, what, whole)
            clouds.append(cloud)
        doubt = self.doubt(torch.cat([whole, made.mean(1)], -1)).squeeze(-1)
        return clouds, doubt


class _Stage(nn.Module):
    """One stage of the encoder: each of some points reads its nearest points of the stage before."""

    def __init__(self, before: int, channels: int, neighbours: int) -> None:
        super().__init__()
        self.neighbours = neighbours
        self.read = _mlp(before + 3, channels, channels)
        self.mix = _mlp(channels + 3, channels, channels)

    def forward(self, points: Tensor, features: Tensor | None, kept: Tensor) -> tuple[Tensor, Tensor]:
        """The kept points (B, m, 3), and their features (B, m, C) of points (B, n, 3) with features (B, n, D)."""
        index = nearest_points(kept, points, self.neighbours)
        near = gather_points(points, index) - kept.unsqueeze(2)  # (B, m, k, 3)
        if features is not None:
            near = torch.cat([near, gather_points(features, index)], -1)
        pooled = self.read(near).amax(2)
        return kept, self.mix(torch.cat([pooled, kept], -1))


class _Upsample(nn.Module):
    """One step of the decoder: each point reads the seeds around it and becomes several."""

    def __init__(self, factor: int, seed: int, features: int, hidden: int, sources: int, first: bool) -> None:
        super().__init__()
        self.factor, self.sources = factor, sources
        self.value = nn.Linear(seed, hidden)
        self.near = _mlp(3, hidden, hidden)
        self.score = _mlp(hidden, hidden, hidden)
        self.whole = nn.Linear(features, hidden)
        self.mix = _mlp(hidden if first else 2 * hidden, 2 * hidden, hidden)
        self.split = nn.Linear(hidden, factor * hidden)
        self.move = _mlp(hidden, hidden, 3)

    def forward(
        self, cloud: Tensor, carried: Tensor | None, where: Tensor, what: Tensor, whole: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Points (B, m factor, 3) and their features, of points (B, m, 3) with features (B, m, hidden).

        Args:
            cloud: points.
            carried: their features of the last step.
            where: seeds (B, s, 3).
            what: their features (B, s, C).
            whole: global feature (B, F).
        """
        index = nearest_points(cloud, where, self.sources)
        gap = self.near(cloud.unsqueeze(2) - gather_points(where, index))  # (B, m, k, hidden)
        mixed = gap + gather_points(self.value(what), index)
        read = (self.score(mixed).softmax(2) * mixed).sum(2) + self.whole(whole).unsqueeze(1)
        if carried is not None:
            read = torch.cat([read, carried], -1)
        children = F.gelu(self.split(self.mix(read))).unflatten(-1, (self.factor, -1)).flatten(1, 2)
        return cloud.repeat_interleave(self.factor, 1) + self.move(children), children


def _mlp(*sizes: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in itertools.pairwise(sizes):
        layers += [nn.Linear(a, b), nn.GELU()]
    return nn.Sequential(*layers[:-1])
