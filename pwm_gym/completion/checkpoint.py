"""Checkpoints of the completion network."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pwm_gym.completion.network import CompletionConfig, CompletionNet
from pwm_gym.errors import CheckpointError, unknown_name
from pwm_gym.learning import load_weights, read_description, rebuild, save_weights
from pwm_gym.schema import convert

__all__ = ["SHIPPED", "load_completion", "save_completion"]

SHIPPED = Path(__file__).parent / "weights"
"""Folder of the network that comes with the package."""
_FORMAT, _SCHEMA = "pwm_gym.completion", 1


@dataclass(frozen=True)
class _Description:
    """What the description must hold."""

    config: dict[str, Any]
    training: dict[str, Any]


def save_completion(folder: Path, net: CompletionNet, training: dict[str, Any], metrics: dict[str, Any]) -> None:
    """Write a network to ``folder``: ``model.safetensors`` and ``config.json``."""
    facts = {"config": asdict(net.config), "training": training, "metrics": metrics}
    save_weights(folder, net, {"format": _FORMAT, "schema": _SCHEMA, **facts})


def load_completion(checkpoint: str | Path = "default") -> tuple[CompletionNet, dict[str, Any]]:
    """A network that :func:`save_completion` wrote, in evaluation mode, and its description.

    Args:
        checkpoint: a folder, or "default" for the shipped one.

    Raises:
        UnknownNameError: there is no such folder.
        CheckpointError: truncated, foreign, or of a newer schema.
    """
    folder = SHIPPED if str(checkpoint) == "default" else Path(checkpoint)
    if not folder.is_dir():
        raise unknown_name("checkpoint of completion", str(checkpoint), ["default"])
    description = read_description(folder, _FORMAT, _SCHEMA, _Description)
    config = convert(description["config"], CompletionConfig, CheckpointError, f"{folder}: config")
    net = rebuild(folder, asdict(config), lambda: CompletionNet(config))
    load_weights(net, folder)
    return net, description
