"""What a cost makes of a scene, drawn as a map: an entity is moved through a plane, all else stays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from pwm_gym.costs import Cost, StagedCost, cost_info
from pwm_gym.costs.registry import Function
from pwm_gym.planning.objective import MOST_POINTS
from pwm_gym.scene import RigidState

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

__all__ = ["CostMap", "cost_maps", "draw_cost_maps"]

_PLANES = {"x-y": (0, 1), "x-z": (0, 2)}
_CELLS = 41  # of a side of a map
_CHUNK = 256  # scenes that are judged at once


@dataclass(frozen=True)
class CostMap:
    """A cost over a plane through a scene."""

    axes: str
    """Names of the plane's axes: "x-y" or "x-z"."""
    across: np.ndarray
    """Coordinates (C,) of the moved entity along the first axis, metres."""
    upward: np.ndarray
    """Coordinates (C,) along the second one."""
    values: np.ndarray
    """Costs (C, C); the second axis comes first."""


@torch.no_grad()
def cost_maps(
    cost: Cost, grasp: Function, state: RigidState, goal: Tensor, action: Tensor, entity: str, reach: float = 0.15
) -> list[CostMap]:
    """The cost of a scene (1,) with an entity, and all that hangs on it, moved by up to ``reach`` metres each way.

    Args:
        cost: to draw; of a sequence of stages the scene's own stage.
        grasp: rule for ``info["grasped"]``.
        state: scene (1,).
        goal: (1, G).
        action: that led to the scene (1, A).
        entity: name of what is moved.
        reach: greatest distance along each axis, metres.

    Raises:
        UnknownNameError: the scene has no such entity.
    """
    place = state.layout.index(entity)
    if state.layout.points > MOST_POINTS:
        state = state.coarsen(state.layout.resize(MOST_POINTS))
    moved = [i for i in range(len(state.layout)) if i == place or place in state.layout.ancestors(i)]
    steps = torch.linspace(-reach, reach, _CELLS)
    centre = state.frames[0, 0, place, :3, 3]
    maps = []
    for axes, (first, second) in _PLANES.items():
        offsets = torch.zeros(_CELLS, _CELLS, 3)
        offsets[..., first] += steps
        offsets[..., second] += steps.unsqueeze(-1)
        values = _judged(cost, grasp, state, goal, action, moved, offsets.flatten(0, 1))
        across, upward = ((steps + centre[k]).numpy() for k in (first, second))
        maps.append(CostMap(axes, across, upward, values.view(_CELLS, _CELLS).numpy()))
    return maps


def _judged(
    cost: Cost, grasp: Function, state: RigidState, goal: Tensor, action: Tensor, moved: list[int], offsets: Tensor
) -> Tensor:
    """Costs (K,) of the scene with entities moved by offsets (K, 3), as they would be at rest there."""
    stage = None
    if isinstance(cost, StagedCost):
        stage = cost.advance(cost.begin(1), *cost_info(state, action, goal, grasp))
    found = []
    for part in offsets.split(_CHUNK):
        count = len(part)
        scenes = state.map(lambda x, count=count: x.expand(count, *x.shape[1:]).clone())
        for k in moved:
            scenes.frames[:, :, k, :3, 3] += part.unsqueeze(1)
        points, info = cost_info(scenes, action.expand(count, -1), goal.expand(count, -1), grasp)
        if stage is not None:
            info["stage"] = stage.expand(count)
        found.append(cost(points, info))
    return torch.cat(found)


def draw_cost_maps(path: Path, maps: list[CostMap], cost: Cost, entity: str) -> None:
    """Draw maps side by side into a PNG; a cross marks where the entity is in the scene.

    Args:
        path: file to write.
        maps: of one entity.
        cost: for the title.
        entity: what was moved.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.8 * len(maps), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{cost.name}, {entity} moved")
    low, high = min(m.values.min() for m in maps), max(m.values.max() for m in maps)
    for axes, one in zip(np.atleast_1d(figure.subplots(1, len(maps))), maps, strict=True):
        picture = _draw(axes, one, float(low), float(high))
    figure.colorbar(picture, ax=figure.axes, label="cost")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


def _draw(axes: Axes, one: CostMap, low: float, high: float) -> QuadMesh:
    first, second = one.axes.split("-")
    picture = axes.pcolormesh(
        one.across, one.upward, one.values, cmap="viridis", vmin=low, vmax=high, shading="nearest"
    )
    if high > low:
        axes.contour(one.across, one.upward, one.values, levels=8, colors="white", linewidths=0.5, alpha=0.6)
    axes.plot(one.across[_CELLS // 2], one.upward[_CELLS // 2], "+", color="red", markersize=12)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{first} (m)")
    axes.set_ylabel(f"{second} (m)")
    return picture
