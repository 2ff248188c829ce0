"""Checkpoints: safetensors weights, a JSON description and banks of initial scenes in one folder.

A checkpoint belongs to a robot; it has a bank of scenes of each task that it was trained on.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from pwm_gym.dynamics.bank import SceneBank
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.dynamics.registry import build_model, config_of
from pwm_gym.errors import CheckpointError, UnknownNameError, unknown_name
from pwm_gym.learning import load_weights, read_description, rebuild, save_weights
from pwm_gym.robots import Control
from pwm_gym.scene import SCHEMA, Layout
from pwm_gym.scene.joint import JOINT_KINDS

__all__ = [
    "SHIPPED",
    "Checkpoint",
    "SceneBank",
    "bank_path",
    "default_checkpoints",
    "load_checkpoint",
    "resolve",
    "save_checkpoint",
    "shipped",
]

_FORMAT = "pwm_gym.checkpoint"
_SCENES = "scenes-"
_BANKS = f"{_SCENES}*.npz"
_OLD = (
    "is of version 0.1, whose weights do not fit; "
    "train it again from its data set, which loads as it is: pwm-gym train --data DATA"
)
SHIPPED = Path(__file__).parent.parent / "checkpoints"
"""Folder of the checkpoints that come with the package."""


@dataclass(frozen=True)
class _Description:
    """What a checkpoint's description must hold."""

    tasks: list[str]
    model: str
    config: dict[str, Any]
    links: Any
    control: Any


@dataclass(frozen=True)
class Checkpoint:
    """A trained world model with what is known of it."""

    model: WorldModel
    kind: str
    tasks: tuple[str, ...]
    """Tasks that it was trained on last, of which it has initial scenes."""
    description: dict[str, Any]
    banks: dict[str, SceneBank] = field(default_factory=dict)
    """Task -> initial scenes."""
    folder: Path = Path()

    @property
    def seen_tasks(self) -> tuple[str, ...]:
        """Every task whose data the weights have seen: those of the checkpoints that training started from, too."""
        return tuple(self.description["training"].get("seen_tasks", self.tasks))

    @property
    def seen_joints(self) -> tuple[str, ...]:
        """Kinds of joints that what the robot does not drive had in the data that the weights have seen."""
        training = self.description["training"]
        return tuple(training.get("seen_joints", (training.get("data") or {}).get("joints", JOINT_KINDS)))

    def check_robot(self, layout: Layout, control: Control) -> None:
        """Raise :class:`CheckpointError` unless the scenes' robot and the meaning of actions are the model's."""
        own, other = self.model.links.names, layout.robot().names
        if {*own} != {*other}:
            raise CheckpointError(f"{self.folder} is of a robot with {', '.join(own)}; expected {', '.join(other)}")
        if self.model.action_size != control.size:
            raise CheckpointError(
                f"{self.folder} takes actions of {self.model.action_size} components; expected {control.size}"
            )

    def check_joints(self, layout: Layout) -> None:
        """Warn where a part hangs on a joint of a kind that no training data had; it is moved all the same."""
        known = (*self.seen_joints, "fixed")
        strange = {e.name: e.joint.kind for e in layout if not e.driven and e.joint.kind not in known}
        if strange:
            told = ", ".join(f"{name!r} ({kind})" for name, kind in strange.items())
            warnings.warn(f"{self.folder} was trained without joints as of {told}; expect larger errors", stacklevel=2)

    def bank(self, task: str) -> SceneBank:
        """Initial scenes of a task.

        Raises:
            CheckpointError: it has none of this task.
        """
        if task not in self.banks:
            known = ", ".join(self.banks) or "no task"
            raise CheckpointError(f"{self.folder} has scenes of {known}; expected {task!r}, or a scene at reset")
        return self.banks[task]


def save_checkpoint(
    folder: Path,
    model: Any,
    kind: str,
    banks: Sequence[SceneBank],
    training: dict[str, Any],
    metrics: dict[str, Any],
) -> None:
    """Write ``model`` to ``folder``: ``model.safetensors``, ``config.json``, ``scenes-<task>.npz``."""
    description = {
        "format": _FORMAT,
        "schema": SCHEMA,
        "tasks": [bank.task for bank in banks],
        "model": kind,
        "config": config_of(model),
        "links": model.links.to_json(),
        "control": model.control.to_json(),
        "training": training,
        "metrics": metrics,
    }
    named = {bank_path(folder, bank.task): bank for bank in banks}
    for path in {*folder.glob(_BANKS)} - named.keys():
        path.unlink()  # of an earlier model's tasks
    for path, bank in named.items():
        bank.save(path)
    save_weights(folder, model, description)


def bank_path(folder: Path, task: str) -> Path:
    """File of a task's initial scenes in a checkpoint's folder."""
    return folder / f"{_SCENES}{task}.npz"


def shipped() -> dict[str, Path]:
    """Name -> folder of the checkpoints that come with the package."""
    return {path.parent.name: path.parent for path in sorted(SHIPPED.glob("*/config.json"))}


def default_checkpoints() -> dict[str, Path]:
    """Task -> folder of the checkpoint that "default" means: its own, or one that is shared with other tasks."""
    found = shipped()
    shared = {path.stem.removeprefix(_SCENES): folder for folder in found.values() for path in folder.glob(_BANKS)}
    return shared | {name: folder for name, folder in found.items() if name in shared}


def resolve(checkpoint: str | Path, task: str) -> Path:
    """Folder of a checkpoint: a path, the name of a shipped one, ``"default"`` for the task's, or ``"hf://owner/name"``.

    Raises:
        UnknownNameError: neither a folder nor a shipped name, or none is shipped for the task.
        CheckpointError: a repository that cannot be reached.
    """
    if not isinstance(checkpoint, str | Path):
        raise unknown_name("checkpoint", checkpoint, [*shipped(), "default"])
    if str(checkpoint).startswith("hf:/"):  # a path of this name has lost a slash
        from pwm_gym.dynamics.hub import HUB, download

        return download(HUB + str(checkpoint).removeprefix("hf:").lstrip("/"))
    known, defaults = shipped(), default_checkpoints()
    if str(checkpoint) == "default":
        if task in defaults:
            return defaults[task]
        raise UnknownNameError(
            f"no checkpoint of task {task!r} is shipped (shipped: {', '.join(sorted(defaults)) or 'none'}); train one "
            f"with `pwm-gym collect --task {task}` and `pwm-gym train --data data-sets/{task}`, then pass its folder"
        )
    if str(checkpoint) in known:
        return known[str(checkpoint)]
    path = Path(checkpoint)
    if not path.is_dir():
        raise unknown_name("checkpoint", str(checkpoint), [*known, "default"])
    return path


def load_checkpoint(folder: str | Path, device: str = "cpu") -> Checkpoint:
    """Read a checkpoint that :func:`save_checkpoint` wrote; the model is in evaluation mode on ``device``.

    Raises:
        CheckpointError: truncated, foreign, or of a newer schema.
    """
    folder = Path(folder)
    description = read_description(folder, _FORMAT, SCHEMA, _Description, _OLD)
    try:
        links = Layout.from_json(description["links"])
    except ValueError as error:
        raise CheckpointError(f"{folder}: {error}") from error
    control = Control.from_json(description["control"])
    config = description["config"]
    model = rebuild(folder, config, lambda: build_model(description["model"], links, control, config))
    load_weights(model, folder)
    paths = sorted(folder.glob(_BANKS))
    banks = {bank.task: bank for bank in map(SceneBank.load, paths)}
    tasks = tuple(map(str, description["tasks"]))
    return Checkpoint(model.to(device), description["model"], tasks, description, banks, folder)  # type: ignore[arg-type]


def use_device(device: str) -> torch.device:
    """A PyTorch device that exists here.

    Raises:
        CheckpointError: it is none, or CUDA where there is none.
    """
    try:
        known = torch.device(device)
    except (RuntimeError, TypeError) as error:
        raise CheckpointError(f"device={device!r}; expected a PyTorch device, such as 'cpu' or 'cuda'") from error
    if known.type == "cuda" and not torch.cuda.is_available():
        raise CheckpointError(f"device={device!r}, but PyTorch {torch.__version__} sees no CUDA device; use 'cpu'")
    return known
