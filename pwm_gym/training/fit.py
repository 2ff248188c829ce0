"""A data set, a world model and its checkpoint: what ``pwm-gym train`` does."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import nn

from pwm_gym.data.augment import Reframed
from pwm_gym.data.dataset import Dataset, load_split, read_header
from pwm_gym.data.episodes import KINDS
from pwm_gym.data.partial import PartialWindows, visible_split
from pwm_gym.data.windows import Windows
from pwm_gym.dynamics.checkpoint import SceneBank, save_checkpoint, use_device
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.dynamics.registry import build_model
from pwm_gym.errors import DatasetError, unknown_name
from pwm_gym.learning import Clock, has_state, is_main_process
from pwm_gym.tasks import Task, get_task
from pwm_gym.training.losses import TrainConfig, train

__all__ = ["BANK", "FitConfig", "fit", "fit_baseline", "fit_error", "scene_bank"]

BANK = 256
"""Initial scenes that a checkpoint carries."""
_BOOST = 3.0  # windows with pushes, drops and releases are drawn this many times as often

Validate = Callable[[Any, Dataset, Any], dict[str, float]]
_ERROR_CHUNK, _ERROR_POINTS = 2048, 32
_ERROR_WINDOWS, _ERROR_HORIZON = 1024, 30  # rollouts that tell how errors of steps add up
_VIEWS = ("complete", "partial")


@dataclass(frozen=True)
class FitConfig:
    """What to train on what."""

    task: str = "PickCube"
    """Registered task; the command line reads it from ``data`` where that is given."""
    data: tuple[Path, ...] = ()
    """Folders of data sets (``pwm-gym collect``); their training splits are joined. None given takes ``data-sets/`` and
    the task's name."""
    out: Path | None = None
    """Folder of the run: TensorBoard curves, the state to resume from, and ``checkpoint``. None takes ``runs/`` and the
    task's name."""
    model: str = "compact"
    """Registered kind of world model."""
    settings: dict[str, int | float | bool | str] = field(default_factory=dict)
    """Overrides of the kind's hyper-parameters, such as ``width 96 blocks 3``."""
    view: str = "complete"
    """"complete" clouds, or "partial": what one ray-cast camera sees, as the paper's baselines get."""
    episodes: int = 0
    """Train on so many episodes, evenly chosen; 0 takes all."""
    kinds: tuple[str, ...] = ()
    """Train on these kinds of episodes alone; none given takes all."""
    arm_steps: int = 6000
    """Optimiser steps, before training begins, on the response of a known arm's joints."""
    error_steps: int = 3000
    """Optimiser steps, after training, on what the model expects to be its error."""
    boost: float = _BOOST
    """How much likelier windows with an object's own motion are drawn."""

    @property
    def folders(self) -> tuple[Path, ...]:
        """Folders of the data sets."""
        return self.data or (Path("data-sets") / self.task,)

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return Path("runs") / self.task if self.out is None else self.out


def fit(config: FitConfig, training: TrainConfig, validate: Validate, progress: bool = True) -> Path:
    """Train and return the checkpoint's folder.

    Args:
        config: what to train on what.
        training: how.
        validate: metrics of a model on a data set (rollouts of validation episodes), given its visible points, if the
            view is partial.
        progress: whether to show bars.

    Raises:
        DatasetError: a data set is missing, truncated or of another task.
    """
    task = get_task(config.task)
    use_device(training.device)
    splits = [load_split(folder, "train", task.name) for folder in config.folders]
    dataset = _chosen(_joined(splits), config)
    held_out = load_split(config.folders[0], "validation", task.name)
    windows, held_out_seen = Windows(dataset, config.boost), None
    if config.view not in _VIEWS:
        raise unknown_name("view", config.view, _VIEWS)
    if config.view == "partial":
        if config.episodes or config.kinds or len(config.folders) > 1:
            raise DatasetError("view='partial' trains on all episodes of one data set; expected no choice of them")
        folder = config.folders[0]
        windows = PartialWindows(dataset, visible_split(folder, "train", task, dataset), boost=config.boost)
        held_out_seen = visible_split(folder, "validation", task, held_out)
    clock = Clock()
    torch.set_num_threads(training.threads)  # before the fits: sums depend on it, and a resumed run must find the same
    torch.manual_seed(training.seed)
    model = build_model(config.model, task.layout, task.action_size, task.control, config.settings)
    if not has_state(config.folder):  # a resumed run reads what was fitted
        _fit_response(model, dataset, config.arm_steps)
    checkpoint = config.folder / "checkpoint"
    description: dict[str, Any] = {
        "config": json.loads(json.dumps(asdict(training), default=str)),
        "data": _describe(config, dataset),
        "windows_boost": config.boost,
    }
    bank = scene_bank(task, dataset)

    def save(trained: nn.Module, metrics: dict[str, float]) -> None:
        description.update(clock.spent())
        save_checkpoint(checkpoint, trained, config.model, bank, description, {"validation": metrics})

    def measure(trained: Any) -> dict[str, float]:
        return validate(trained, held_out, held_out_seen)

    metrics = train(model, Reframed(windows), training, config.folder, measure, save, progress, clock)
    if is_main_process() and getattr(model, "error", None) is not None:
        fit_error(model, dataset, config.error_steps)
        save(model, metrics or measure(model))  # a resumed run may have had nothing left to train
    return checkpoint


def _joined(splits: list[Dataset]) -> Dataset:
    first = splits[0]
    return Dataset(first.task, first.layout, first.clouds, tuple(e for s in splits for e in s.episodes))


def _chosen(dataset: Dataset, config: FitConfig) -> Dataset:
    """The training episodes that ``config`` asks for."""
    if config.kinds:
        dataset = dataset.of_kinds(config.kinds)
    count = len(dataset.episodes)
    if config.episodes > count:
        raise DatasetError(f"episodes={config.episodes}; the data has {count}")
    if config.episodes:
        index = np.linspace(0, count - 1, config.episodes).round().astype(int)
        dataset = replace(dataset, episodes=tuple(dataset.episodes[i] for i in index))
    return dataset


def _fit_response(model: nn.Module, dataset: Dataset, arm_steps: int) -> None:
    """The parts of a model that are fitted on every training transition before it is trained on rollouts."""
    response, arm = getattr(model, "response", None), getattr(model, "arm", None)
    if response is None and arm is None:
        return
    every = Windows(dataset).transitions()
    if response is not None:
        response.fit(every.frames, every.actions[:, 0], every.following[:, 0])
    if arm is not None:
        arm.fit(every.joints, every.actions[:, 0], every.following_joints[:, 0], arm_steps)


@torch.no_grad()
def fit_error(model: Any, dataset: Dataset, steps: int) -> None:
    """Fit what a trained model expects to be its error, on every transition of ``dataset`` and on rollouts of it."""
    windows = Windows(dataset)
    tokens, errors = [], []
    for batch in windows.chunks(_ERROR_CHUNK):
        state = model.prepare(batch.state().coarsen(dataset.layout.truncate(_ERROR_POINTS)))
        after, seen = model.step_with_tokens(state, batch.actions[:, 0])
        errors.append(_gaps(after, batch.following[:, 0]))
        tokens.append(seen)
    with torch.enable_grad():
        model.error.fit(torch.cat(tokens), torch.cat(errors), steps)
    _scale_error(model, windows)


@torch.no_grad()
def _scale_error(model: Any, windows: Windows) -> None:
    """Scale the expected error so that it is right on average over rollouts."""
    batch = windows.sample(torch.Generator().manual_seed(0), _ERROR_WINDOWS, _ERROR_HORIZON)
    state = model.prepare(batch.state().coarsen(windows.layout.truncate(_ERROR_POINTS)))
    expected, real = 0.0, 0.0
    for h in range(_ERROR_HORIZON):
        state = model.step(state, batch.actions[:, h])
        expected += float(state.error.mean())
        real += float(_gaps(state, batch.following[:, h]).mean())
    model.error.factor.mul_(real / max(expected, 1e-12))


def _gaps(state: Any, truth: torch.Tensor) -> torch.Tensor:
    """Mean distance (B, E) of each entity's points from where they are at ``truth`` (B, E, 4, 4)."""
    gaps = (state.points() - state.advance(truth).points()).norm(dim=-1)
    return torch.stack([gaps[:, e.slice].mean(1) for e in state.layout], 1)


def fit_baseline(kind: str, task: Task, dataset: Dataset) -> WorldModel:
    """A baseline without learning; what response it has is fitted on every transition of ``dataset``."""
    model: Any = build_model(kind, task.layout, task.action_size, task.control)
    _fit_response(model, dataset, arm_steps=0)
    return cast("WorldModel", model)


def _describe(config: FitConfig, dataset: Dataset) -> dict[str, Any]:
    """What the training data is, for the checkpoint's description."""
    kinds = np.bincount([e.kind for e in dataset.episodes], minlength=len(KINDS))
    return {
        "settings": [read_header(folder)["settings"] for folder in config.folders],
        "episodes": dict(zip(KINDS, map(int, kinds), strict=True)),
        "transitions": sum(len(e) for e in dataset.episodes),
        "view": config.view,
        "source": "ManiSkill 3 simulation (Apache-2.0), scripted expert",
    }


def scene_bank(task: Task, dataset: Dataset) -> SceneBank:
    """Initial scenes of the first training episodes."""
    chosen = dataset.episodes[:BANK]
    return SceneBank(
        task.name,
        dataset.layout,
        dataset.clouds,
        np.stack([e.poses[0] for e in chosen]),
        np.stack([e.goal for e in chosen]),
        np.stack([e.joints[0, 0] for e in chosen]),
    )
