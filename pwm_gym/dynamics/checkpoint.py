"""Checkpoints: safetensors weights, a JSON description and a bank of initial scenes in one folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pwm_gym.dynamics.model import WorldModel
from pwm_gym.dynamics.registry import build_model, config_of
from pwm_gym.errors import CheckpointError, UnknownNameError, unknown_name
from pwm_gym.files import load_arrays, save_arrays
from pwm_gym.learning import load_weights, read_description, save_weights
from pwm_gym.robots import Control
from pwm_gym.scene import Layout, Scene

__all__ = ["SCHEMA", "SHIPPED", "Checkpoint", "SceneBank", "load_checkpoint", "resolve", "save_checkpoint"]

SCHEMA = 1
_FORMAT = "pwm_gym.checkpoint"
_NO_MODEL = (RuntimeError, ValueError, TypeError, ArithmeticError, LookupError, MemoryError, AttributeError)
_BANK = ("clouds", "poses", "goals", "joints")
SHIPPED = Path(__file__).parent.parent / "checkpoints"
"""Folder of the checkpoints that come with the package, one a task."""


@dataclass(frozen=True)
class _Description:
    """What a checkpoint's description must hold."""

    task: str
    model: str
    config: dict[str, Any]
    layout: Any
    action_size: int
    control: Any


@dataclass(frozen=True)
class SceneBank:
    """Initial scenes of one task that share their canonical clouds; drawn from training seeds."""

    task: str
    layout: Layout
    clouds: np.ndarray
    """(N, 3) float32."""
    poses: np.ndarray
    """(M, E, 7) float32."""
    goals: np.ndarray
    """(M, G) float32."""
    joints: np.ndarray | None = None
    """Joint positions (M, J) float32."""

    def __len__(self) -> int:
        return len(self.poses)

    def scene(self, index: int) -> Scene:
        """The scene at ``index``, at rest."""
        poses = np.repeat(self.poses[index].astype(np.float64)[None], 3, 0)
        joints = None if self.joints is None else np.stack([self.joints[index], np.zeros_like(self.joints[index])])
        return Scene(self.task, self.layout, self.clouds, poses, self.goals[index], joints)


@dataclass(frozen=True)
class Checkpoint:
    """A trained world model with what is known of it."""

    model: WorldModel
    task: str
    kind: str
    description: dict[str, Any]
    bank: SceneBank


def save_checkpoint(
    folder: Path, model: Any, kind: str, bank: SceneBank, training: dict[str, Any], metrics: dict[str, Any]
) -> None:
    """Write ``model`` to ``folder``: ``model.safetensors``, ``config.json``, ``scenes.npz``."""
    description = {
        "format": _FORMAT,
        "schema": SCHEMA,
        "task": bank.task,
        "model": kind,
        "config": config_of(model),
        "layout": model.layout.to_json(),
        "action_size": model.action_size,
        "control": model.control.to_json(),
        "training": training,
        "metrics": metrics,
    }
    arrays = {k: v for k in _BANK if (v := getattr(bank, k)) is not None}
    save_arrays(folder / "scenes.npz", arrays)
    save_weights(folder, model, description)


def resolve(checkpoint: str | Path, task: str) -> Path:
    """Folder of a checkpoint: a path, the name of a shipped one, or ``"default"`` for the task's own.

    Raises:
        UnknownNameError: neither a folder nor a shipped name, or none is shipped for the task.
    """
    shipped = {p.parent.name: p.parent for p in SHIPPED.glob("*/config.json")}
    own = str(checkpoint) == "default"
    name = task if own else str(checkpoint)
    if name in shipped:
        return shipped[name]
    if own:
        raise UnknownNameError(
            f"no checkpoint of task {task!r} is shipped (shipped: {', '.join(sorted(shipped)) or 'none'}); train one "
            f"with `pwm-gym collect --task {task}` and `pwm-gym train --data data-sets/{task}`, then pass its folder"
        )
    path = Path(checkpoint)
    if not path.is_dir():
        raise unknown_name("checkpoint", str(checkpoint), [*shipped, "default"])
    return path


def load_checkpoint(folder: str | Path, task: str | None = None, device: str = "cpu") -> Checkpoint:
    """Read a checkpoint that :func:`save_checkpoint` wrote; the model is in evaluation mode on ``device``.

    Raises:
        CheckpointError: truncated, foreign, of another task, or of a newer schema.
    """
    folder = Path(folder)
    description = read_description(folder, _FORMAT, SCHEMA, _Description)
    if task is not None and description["task"] != task:
        raise CheckpointError(f"{folder} is a checkpoint of task {description['task']!r}; expected {task!r}")
    layout = Layout.from_json(description["layout"])
    control = Control.from_json(description["control"])
    with torch.random.fork_rng(devices=[]):  # fresh weights are drawn only to be replaced
        try:
            model = build_model(
                description["model"], layout, description["action_size"], control, description["config"]
            )
        except _NO_MODEL as error:
            raise CheckpointError(f"{folder}: its config.json describes no model ({error})") from error
    load_weights(model, folder)
    bank = _bank(folder / "scenes.npz", description["task"], layout)
    return Checkpoint(model.to(device), description["task"], description["model"], description, bank)  # type: ignore[arg-type]


def _bank(path: Path, task: str, layout: Layout) -> SceneBank:
    complaint = "is truncated or not a scene bank"
    arrays, _ = load_arrays(path, complaint, CheckpointError)
    if missing := [name for name in _BANK[:3] if name not in arrays]:
        raise CheckpointError(f"{path} {complaint} (it lacks {', '.join(missing)})")
    return SceneBank(task, layout, **{name: arrays[name] for name in _BANK if name in arrays})


def use_device(device: str) -> torch.device:
    """A PyTorch device that exists here.

    Raises:
        CheckpointError: CUDA was asked for where there is none.
    """
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise CheckpointError(f"device={device!r}, but PyTorch {torch.__version__} sees no CUDA device; use 'cpu'")
    return torch.device(device)
