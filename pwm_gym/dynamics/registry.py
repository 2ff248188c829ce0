"""World models by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from torch import nn

from pwm_gym.dynamics.baselines.graph import GraphConfig, GraphModel
from pwm_gym.dynamics.baselines.linear import BaselineConfig, Commanded, LinearBaseline, Still
from pwm_gym.dynamics.baselines.particleformer import ParticleFormer, ParticleFormerConfig
from pwm_gym.dynamics.compact.model import CompactConfig, CompactModel
from pwm_gym.dynamics.paper.model import PaperConfig, PaperModel, SmallPaperConfig
from pwm_gym.errors import CheckpointError, look_up, unknown_name
from pwm_gym.robots import Control
from pwm_gym.scene import Layout
from pwm_gym.schema import convert

__all__ = ["MODELS", "ModelKind", "build_model", "model_kind"]


@dataclass(frozen=True)
class ModelKind:
    """How to build one kind of world model."""

    config: type
    """Frozen dataclass of its hyper-parameters."""
    build: Callable[[Layout, Control, Any], nn.Module]
    """Layout, meaning of the action and config -> model."""


MODELS: dict[str, ModelKind] = {
    "compact": ModelKind(CompactConfig, CompactModel),
    "paper": ModelKind(PaperConfig, PaperModel),
    "paper-small": ModelKind(SmallPaperConfig, PaperModel),
    "particleformer": ModelKind(ParticleFormerConfig, ParticleFormer),
    "gbnd": ModelKind(GraphConfig, GraphModel),
    "still": ModelKind(BaselineConfig, Still),
    "commanded": ModelKind(BaselineConfig, Commanded),
    "linear": ModelKind(BaselineConfig, LinearBaseline),
}
"""Name -> kind; the last three are the baselines without learning."""


def model_kind(name: str) -> ModelKind:
    """The kind called ``name``.

    Raises:
        UnknownNameError: listing the known kinds and the nearest one.
    """
    return look_up("world model", name, MODELS)


def build_model(
    name: str,
    layout: Layout,
    control: Control,
    config: Mapping[str, Any] | None = None,
) -> nn.Module:
    """A fresh model of kind ``name``; ``config`` overrides its defaults (JSON lists become tuples)."""
    kind = model_kind(name)
    known = {f.name for f in fields(kind.config)}
    values = dict(config or {})
    for key in values:
        if key not in known:
            raise CheckpointError(str(unknown_name(f"{name} setting", key, known)))
    settings: Any = convert(values, kind.config, CheckpointError, f"{name} settings")
    return kind.build(layout, control, settings)


def config_of(model: Any) -> dict[str, Any]:
    """JSON form of a model's hyper-parameters."""
    return asdict(model.config)
