"""GBND, graph-based neural dynamics (a baseline in the paper's appendix): messages between neighbouring points."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pwm_gym.dynamics.pointwise import PointwiseConfig, PointwiseModel, velocity_head
from pwm_gym.robots import Control
from pwm_gym.scene import Layout

__all__ = ["GraphConfig", "GraphModel"]


@dataclass(frozen=True)
class GraphConfig(PointwiseConfig):
    """Hyper-parameters of :class:`GraphModel`."""

    entity_features: bool = True
    """A point tells its entity."""
    width: int = 128
    """Channels of a node and of a message."""
    neighbours: int = 10
    """Nearest points that send messages to each point."""
    rounds: int = 3
    """Rounds of messages, all with the same weights."""
    head_layers: int = 3
    """Linear layers from a node to its velocity."""


class GraphModel(PointwiseModel):
    """Nodes are points with the action in their features; each hears its nearest neighbours a few times."""

    def __init__(self, layout: Layout, control: Control | None = None, config: GraphConfig | None = None) -> None:
        config = config or GraphConfig()
        super().__init__(layout, control, config)
        width = config.width
        self.node = _mlp(self.channels + self.action_size, width)
        self.edge = _mlp(4, width)
        self.receive, self.send = nn.Linear(width, width), nn.Linear(width, width, bias=False)
        self.message = nn.Linear(width, width)
        self.update = _mlp(2 * width, width)
        self.head = velocity_head(width, config.head_layers)

    def network(self, rows: Tensor, positions: Tensor, action: Tensor) -> Tensor:
        """Scaled velocities (B, N, 3) of features (B, N, C), points (B, N, 3) and actions (B, A)."""
        count = min(self.config.neighbours, positions.shape[1] - 1)
        with torch.no_grad():
            gaps = torch.cdist(positions, positions)
            senders = gaps.topk(count + 1, largest=False).indices[..., 1:]  # (B, N, K)
        apart = (_gather(positions, senders) - positions.unsqueeze(2)) / self.config.position_scale
        edges = self.edge(torch.cat([apart, apart.norm(dim=-1, keepdim=True)], -1))  # (B, N, K, W)
        nodes = self.node(torch.cat([rows, action.unsqueeze(1).expand(-1, rows.shape[1], -1)], -1))
        for _ in range(self.config.rounds):
            # An MLP of [receiver, sender, edge], the mean over senders taken before its last layer, which is linear.
            hidden = self.receive(nodes).unsqueeze(2) + _gather(self.send(nodes), senders) + edges
            heard = self.message(F.gelu(hidden).mean(2))
            nodes = nodes + self.update(torch.cat([nodes, heard], -1))
        return self.head(nodes)


def _gather(values: Tensor, index: Tensor) -> Tensor:
    """Values (B, N, C) of points ``index`` (B, N, K); (B, N, K, C)."""
    flat = index.flatten(1).unsqueeze(-1).expand(-1, -1, values.shape[-1])
    return values.gather(1, flat).unflatten(1, index.shape[1:])


def _mlp(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.GELU(), nn.Linear(width, width))
