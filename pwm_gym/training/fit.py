"""A data set, a world model and its checkpoint: what ``pwm-gym train`` does."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import nn

from pwm_gym.data.augment import Reframed
from pwm_gym.data.banks import bank_of
from pwm_gym.data.batch import Batches
from pwm_gym.data.dataset import Dataset, load_split, read_header
from pwm_gym.data.episodes import DEMONSTRATIONS, KINDS
from pwm_gym.data.partial import PartialWindows, visible_rows
from pwm_gym.data.windows import Windows, mixed
from pwm_gym.dynamics.checkpoint import Checkpoint, SceneBank, load_checkpoint, resolve, save_checkpoint, use_device
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.dynamics.protocols import FitsResponse, LearnsError, Transitions
from pwm_gym.dynamics.registry import build_model
from pwm_gym.errors import DatasetError, PwmGymError, unknown_name, writing
from pwm_gym.learning import Clock, has_state, is_main_process
from pwm_gym.scene import Layout
from pwm_gym.tasks import Task, get_task
from pwm_gym.training.losses import TrainConfig, train

__all__ = ["BANK", "FitConfig", "fit", "fit_baseline", "fit_error", "fit_response", "load_sources", "scene_bank"]

BANK = 256
"""Initial scenes that a checkpoint carries."""
_BOOST = 3.0  # windows with pushes, drops and releases are drawn this many times as often
_ORDERS = 16  # of each cloud's points

Validate = Callable[[Any, Dataset, Any], dict[str, float]]
_ERROR_CHUNK, _ERROR_POINTS = 2048, 32
_ERROR_WINDOWS, _ERROR_HORIZON = 1024, 30  # rollouts that tell how errors of steps add up
_VIEWS = ("complete", "partial")


@dataclass(frozen=True)
class FitConfig:
    """What to train on what."""

    task: str = "PickCube"
    """Registered task whose folder of data is read where ``data`` is not given."""
    data: tuple[Path, ...] = ()
    """Folders of data sets (``pwm-gym collect``), of one task or of several tasks of a robot. None given takes
    ``data-sets/`` and the task's name."""
    out: Path | None = None
    """Folder of the run: TensorBoard curves, the state to resume from, and ``checkpoint``. None takes ``runs/`` and the
    names of the data's tasks."""
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
    init: str = ""
    """Checkpoint (a folder or a shipped one's name) whose weights, the fitted responses included, training starts from
    instead of fresh ones; ``model`` and ``settings`` are then its own."""
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


def fit(config: FitConfig, training: TrainConfig, validate: Validate, progress: bool = True) -> Path:
    """Train and return the checkpoint's folder.

    Args:
        config: what to train on what.
        training: how.
        validate: metrics of a model on a data set (rollouts of validation episodes), given its visible points, if the
            view is partial.
        progress: whether to show bars.

    Raises:
        DatasetError: a data set is missing, truncated, or of another robot than the others.
        UnknownNameError: there is no checkpoint of the name ``init``.
    """
    use_device(training.device)
    whole = load_sources(config.folders, "train")
    tasks = [get_task(dataset.task) for dataset in whole]
    out = config.out or Path("runs") / "+".join(task.name for task in tasks)
    with writing(out):  # before anything is fitted that could not be kept
        out.mkdir(parents=True, exist_ok=True)
    sources = [_chosen(dataset, config, len(whole)) for dataset in whole]
    held_out = load_sources(config.folders, "validation")
    windows = _windows(config, whole, sources)
    partial = config.view == "partial"
    seen = [visible_rows(config.folders, "validation", dataset, dataset) if partial else None for dataset in held_out]
    clock = Clock()
    torch.set_num_threads(training.threads)  # before the fits: sums depend on it, and a resumed run must find the same
    torch.manual_seed(training.seed)
    model: Any
    earlier = load_checkpoint(resolve(config.init, tasks[0].name)) if config.init else None
    kind, model = _fresh(config, earlier, sources[0].layout, tasks[0])
    if not has_state(out) and not config.init:  # a resumed run reads what was fitted
        fit_response(model, sources, config.arm_steps)
    checkpoint = out / "checkpoint"
    description: dict[str, Any] = {
        "config": json.loads(json.dumps(asdict(training), default=str)),
        "data": _describe(config, sources),
        "windows_boost": config.boost,
        "init": config.init,
        **_seen(earlier, sources),
    }
    banks = [scene_bank(dataset) for dataset in sources]

    def save(trained: nn.Module, metrics: dict[str, float]) -> None:
        description.update(clock.spent())
        save_checkpoint(checkpoint, trained, kind, banks, description, {"validation": metrics})

    def measure(trained: Any) -> dict[str, float]:
        if len(held_out) == 1:
            return validate(trained, held_out[0], seen[0])
        found = {dataset.task: validate(trained, dataset, rows) for dataset, rows in zip(held_out, seen, strict=True)}
        return {f"{task}/{name}": value for task, values in found.items() for name, value in values.items()}

    metrics = train(model, Reframed(windows), training, out, measure, save, progress, clock)
    if is_main_process() and isinstance(model, LearnsError) and model.error is not None:
        fit_error(model, sources, config.error_steps)
        save(cast("nn.Module", model), metrics or measure(model))  # a resumed run may have had nothing left to train
    return checkpoint


def _fresh(config: FitConfig, earlier: Checkpoint | None, layout: Layout, task: Task) -> tuple[str, nn.Module]:
    """Kind of model, and the model that training starts from: that of the ``earlier`` checkpoint if there is one.

    Raises:
        CheckpointError: that checkpoint is of another robot.
        PwmGymError: settings beside ``init``, which has its own.
    """
    if earlier is None:
        fresh: Any = build_model(config.model, layout, task.control, config.settings)
        return config.model, fresh
    if config.settings:
        raise PwmGymError(f"settings={config.settings} beside init={config.init!r}; expected none: it has its own")
    earlier.check_robot(layout, task.control)
    model: Any = build_model(earlier.kind, layout, task.control, earlier.description["config"])
    model.load_state_dict(cast("nn.Module", earlier.model).state_dict())
    return earlier.kind, model


def _seen(earlier: Checkpoint | None, sources: list[Dataset]) -> dict[str, list[str]]:
    """Tasks and kinds of joints that the weights will have seen, also in the checkpoint that training starts from."""
    tasks, joints = [dataset.task for dataset in sources], _joints(sources)
    if earlier is not None:
        tasks = [*earlier.seen_tasks, *(name for name in tasks if name not in earlier.seen_tasks)]
        joints = sorted({*joints, *earlier.seen_joints})
    return {"seen_tasks": tasks, "seen_joints": joints}


def _joints(sources: Sequence[Dataset]) -> list[str]:
    """Kinds of joints of what the robot does not drive."""
    return sorted({e.joint.kind for dataset in sources for e in dataset.layout if not e.driven})


def _windows(config: FitConfig, whole: list[Dataset], sources: list[Dataset]) -> Batches:
    """Training windows of ``sources``, the chosen episodes of ``whole`` splits, one a task."""
    if config.view not in _VIEWS:
        raise unknown_name("view", config.view, _VIEWS)
    if config.view == "complete":
        return mixed([Windows(dataset, config.boost, _ORDERS) for dataset in sources])
    windows = []
    for split, chosen in zip(whole, sources, strict=True):
        seen = visible_rows(config.folders, "train", split, chosen)
        windows.append(PartialWindows(chosen, seen, boost=config.boost))
    return mixed(windows)


def load_sources(folders: Sequence[Path], split: str) -> list[Dataset]:
    """One data set a task, of all episodes of ``split`` in ``folders``.

    Raises:
        DatasetError: none is given, two have an asset of one name with other points, or their robots differ.
    """
    if not folders:
        raise DatasetError("data: no folder was given; expected at least one data set")
    by_task: dict[str, Dataset] = {}
    for folder in folders:
        dataset = load_split(folder, split)
        known = by_task.get(dataset.task)
        by_task[dataset.task] = dataset if known is None else joined(known, dataset)
    sources = list(by_task.values())
    first = get_task(sources[0].task).robot
    for dataset in sources[1:]:
        robot = get_task(dataset.task).robot
        if robot.control != first.control or dataset.layout.robot().names != sources[0].layout.robot().names:
            raise DatasetError(
                f"task {dataset.task!r} has robot {robot.name!r} and {sources[0].task!r} has {first.name!r}; "
                "expected data sets of one robot"
            )
    return sources


def joined(first: Dataset, second: Dataset) -> Dataset:
    """The episodes of two data sets of one task.

    Raises:
        DatasetError: their layouts differ, or an asset's points.
    """
    if first.layout != second.layout:
        raise DatasetError(f"two data sets of task {first.task!r} have other entities or numbers of points")
    for name in first.assets.keys() & second.assets.keys():
        if not np.array_equal(first.assets[name], second.assets[name]):
            raise DatasetError(f"two data sets of task {first.task!r} have other canonical points of {name!r}")
    return replace(first, assets={**first.assets, **second.assets}, episodes=first.episodes + second.episodes)


def _chosen(dataset: Dataset, config: FitConfig, tasks: int) -> Dataset:
    """The training episodes that ``config`` asks for, a task's share of them."""
    if config.kinds:
        dataset = dataset.of_kinds(config.kinds)
    count, wanted = len(dataset.episodes), config.episodes // tasks
    if wanted > count:
        raise DatasetError(f"episodes={config.episodes}; the data has {count} of task {dataset.task!r}")
    return dataset.some(wanted) if wanted else dataset


def fit_response(model: Any, sources: Sequence[Dataset], arm_steps: int) -> None:
    """The parts of a model that are fitted on every training transition before it is trained on rollouts.

    Args:
        model: any; one that has no such part is left alone.
        sources: training episodes, one data set a task.
        arm_steps: optimiser steps on the response of a known arm's joints.
    """
    if not isinstance(model, FitsResponse):
        return
    every = [Windows(dataset).transitions() for dataset in sources]
    names = cast("WorldModel", model).links.names
    links = [[batch.layout.index(name) for name in names] for batch in every]
    model.fit_response(
        Transitions(
            links=torch.cat([b.frames[:, :, k] for b, k in zip(every, links, strict=True)]),
            actions=torch.cat([b.actions[:, 0] for b in every]),
            following=torch.cat([b.following[:, 0, k] for b, k in zip(every, links, strict=True)]),
            joints=torch.cat([b.joints for b in every]),
            following_joints=torch.cat([b.following_joints[:, 0] for b in every]),
            floor=max(dataset.layout.floor for dataset in sources),
        ),
        arm_steps,
    )


@torch.no_grad()
def fit_error(model: Any, sources: Sequence[Dataset], steps: int) -> None:
    """Fit what a trained model expects to be its error, on every transition of ``sources`` and on rollouts of them."""
    tokens, errors = [], []
    for dataset in sources:
        few = dataset.layout.truncate(_ERROR_POINTS)
        for batch in Windows(dataset).chunks(_ERROR_CHUNK):
            state = model.prepare(batch.state().coarsen(few))
            after, seen = model.step_with_tokens(state, batch.actions[:, 0])
            errors.append(_gaps(after, batch.following[:, 0]).flatten())
            tokens.append(seen.flatten(0, 1))
    with torch.enable_grad():
        model.error.fit(torch.cat(tokens), torch.cat(errors), steps)
    _scale_error(model, [Windows(dataset) for dataset in sources])


@torch.no_grad()
def _scale_error(model: Any, sources: Sequence[Windows]) -> None:
    """Scale the expected error so that it is right on average over rollouts."""
    expected, real = 0.0, 0.0
    for windows in sources:
        horizon = min(_ERROR_HORIZON, windows.longest)
        batch = windows.sample(torch.Generator().manual_seed(0), _ERROR_WINDOWS, horizon)
        state = model.prepare(batch.state().coarsen(windows.layout.truncate(_ERROR_POINTS)))
        for h in range(horizon):
            state = model.step(state, batch.actions[:, h])
            expected += float(state.error.mean())
            real += float(_gaps(state, batch.following[:, h]).mean())
    model.error.factor.mul_(real / max(expected, 1e-12))


def _gaps(state: Any, truth: torch.Tensor) -> torch.Tensor:
    """Mean distance (B, E) of each entity's points from where they are at ``truth`` (B, E, 4, 4)."""
    gaps = (state.points() - state.advance(truth).points()).norm(dim=-1)
    return torch.stack([gaps[:, e.slice].mean(1) for e in state.layout], 1)


def fit_baseline(kind: str, dataset: Dataset) -> WorldModel:
    """A baseline without learning; what response it has is fitted on every transition of ``dataset``."""
    model: Any = build_model(kind, dataset.layout, get_task(dataset.task).control)
    fit_response(model, [dataset], arm_steps=0)
    return cast("WorldModel", model)


def _describe(config: FitConfig, sources: Sequence[Dataset]) -> dict[str, Any]:
    """What the training data is, for the checkpoint's description."""
    episodes = [e for dataset in sources for e in dataset.episodes]
    kinds = np.bincount([e.kind for e in episodes], minlength=len(KINDS))
    return {
        "settings": [read_header(folder).settings for folder in config.folders],
        "tasks": {dataset.task: len(dataset.episodes) for dataset in sources},
        "episodes": dict(zip(KINDS, map(int, kinds), strict=True)),
        "transitions": sum(map(len, episodes)),
        "joints": _joints(sources),
        "view": config.view,
    }


def scene_bank(dataset: Dataset) -> SceneBank:
    """Initial scenes of the first demonstrations: practice starts where no episode of the task does."""
    kinds = np.array([KINDS[e.kind] for e in dataset.episodes])
    shown = np.flatnonzero(np.isin(kinds, DEMONSTRATIONS))[:BANK]
    places = shown if len(shown) else np.arange(min(BANK, len(kinds)))
    return bank_of(dataset, places.tolist(), [0] * len(places))
