"""Objects, a completion network and its checkpoint: what ``pwm-gym complete train`` does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import nn

from pwm_gym.completion.checkpoint import save_completion
from pwm_gym.completion.meshes import load_meshes, normalise
from pwm_gym.completion.network import CompletionNet, get_size
from pwm_gym.completion.training import CompletionTrainConfig, train_completion
from pwm_gym.completion.views import ViewConfig, Views
from pwm_gym.errors import PwmGymError, unknown_name
from pwm_gym.learning import Clock

if TYPE_CHECKING:
    import trimesh

__all__ = ["ObjectSet", "fit_completion", "random_shapes"]

_SHAPE_SEEDS = 1_000_000  # first seed of the training shapes; validation takes those before it


@dataclass(frozen=True)
class ObjectSet:
    """The objects that completion is trained on."""

    shapes: int = 3000
    """Generated shapes."""
    meshes: Path | None = None
    """Folder, file or archive of meshes to train on, too."""
    held_out: tuple[str, ...] = ()
    """Those of them that are not."""
    share: float = 0.5
    """Share of the views that are of them, if there are any."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            PwmGymError: no object at all, or a share that is none.
        """
        if self.shapes < 1 and self.meshes is None:
            raise PwmGymError(f"shapes={self.shapes} without meshes; expected at least one object")
        if not 0.0 <= self.share <= 1.0:
            raise PwmGymError(f"share={self.share}; expected 0 to 1")

    def read(self, seen: bool = True) -> dict[str, trimesh.Trimesh]:
        """The meshes that are trained on, or those that are held out, by name, each of size 1."""
        if self.meshes is None:
            return {}
        every = load_meshes(self.meshes)
        for name in self.held_out:
            if name not in every:
                raise unknown_name("held-out mesh", name, every)
        return {name: normalise(mesh) for name, mesh in every.items() if (name in self.held_out) != seen}

    def views(self, config: ViewConfig | None = None) -> Views:
        """Random views of all training objects."""
        given, made = list(self.read().values()), random_shapes(self.shapes)
        share = self.share if given and made else float(bool(given))
        weights = [share / max(len(given), 1)] * len(given) + [(1 - share) / max(len(made), 1)] * len(made)
        return Views([*given, *made], config, weights)


def random_shapes(count: int, first: int = _SHAPE_SEEDS) -> list[trimesh.Trimesh]:
    """Generated shapes of the seeds from ``first`` on."""
    from pwm_gym.completion.shapes import random_shape

    return [random_shape(np.random.default_rng(first + k)) for k in range(count)]


def fit_completion(
    objects: ObjectSet,
    size: str,
    training: CompletionTrainConfig,
    out: Path,
    validate: Callable[[Any], dict[str, float]],
    progress: bool = True,
) -> Path:
    """Train a network and return its checkpoint's folder.

    Args:
        objects: to train on.
        size: of the network, by name.
        training: how.
        out: folder of the run; a state found there is resumed.
        validate: metrics of a network.
        progress: whether to show a bar.
    """
    clock, views = Clock(), objects.views()
    torch.manual_seed(training.seed)
    net = CompletionNet(get_size(size))
    checkpoint = out / "checkpoint"

    def save(trained: nn.Module, metrics: Mapping[str, float]) -> None:
        facts = {
            "objects": {**asdict(objects), "meshes": None if objects.meshes is None else objects.meshes.name},
            "size": size,
            "config": asdict(training),
            **clock.spent(),
        }
        assert isinstance(trained, CompletionNet)
        save_completion(checkpoint, trained, facts, dict(metrics))

    train_completion(net, views, training, out, validate, save, progress, clock)
    return checkpoint
