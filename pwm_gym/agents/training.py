"""Reinforcement learning of a task, in its world model or in its simulator twin."""

from __future__ import annotations

import json
import time
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, configure
from tqdm import tqdm

from pwm_gym.agents.config import AgentConfig
from pwm_gym.agents.policy import algorithm_class, policy_name, policy_settings, save_agent
from pwm_gym.agents.worlds import make_world
from pwm_gym.collection.scenes import simulated_bank
from pwm_gym.data import load_demonstrations, underway_bank
from pwm_gym.dynamics import SceneBank, load_checkpoint, resolve
from pwm_gym.errors import CheckpointError, PwmGymError, is_number
from pwm_gym.files import replacing, write_atomically
from pwm_gym.learning import tell_loggers
from pwm_gym.process import prepare_process
from pwm_gym.schema import read_json
from pwm_gym.tasks import Task, get_task

__all__ = ["train"]

_STATE, _PROGRESS, _SCENES = "training-state.zip", "progress.json", "scenes.npz"


@dataclass(frozen=True)
class _Progress:
    """Whose folder it is, and the seconds that the training took so far."""

    run: dict[str, Any]
    seconds: float


def train(task: str, out: Path, config: AgentConfig | None = None, progress: bool = True) -> dict[str, Any]:
    """Train a policy, and return what it took; the same call goes on where a killed run was.

    Args:
        task: registered task.
        out: folder of the policy, of ``snapshots/`` along the way, of TensorBoard's curves, and of the state that a
            killed run resumes from.
        config: settings.
        progress: whether to show a bar.

    Returns:
        Seconds and environment steps of the policy's training, and, of one trained in a model, what the model's own
        data and training were.

    Raises:
        PwmGymError: the folder holds a run of other settings, or settings that do not fit the task.
        CheckpointError: the state to go on from is damaged, or ``config.init`` is no run of such a policy.
        DatasetError: as of :func:`pwm_gym.data.dataset.load_demonstrations`, where starts are drawn from some.
    """
    config, known = config or AgentConfig(), get_task(task)
    prepare_process(config.threads)
    before, begun = _progress(out, known, config), time.perf_counter()
    scenes = _scenes(known, config, out, goes_on=before is not None)
    spent = (before or 0.0) + time.perf_counter() - begun
    with closing(make_world(known, config, scenes)) as world:
        learner = _learner(known, config, world, out)
        if before is None:  # what does not fit has raised by now, and left the folder free
            _claim(out, known, config, spent)
        curves = configure(str(out / "tensorboard"), ["tensorboard"])
        curves.output_formats.append(_Loggers(out))
        learner.set_logger(curves)
        saver = _Saver(learner, known, config, out, spent, progress)
        if (left := config.steps - learner.num_timesteps) > 0 and not saver.late:
            learner.learn(left, callback=saver, reset_num_timesteps=False)
        saver.save()
    return saver.told()


def _claim(out: Path, task: Task, config: AgentConfig, seconds: float) -> None:
    """Note whose folder it is, and what the run took so far."""
    run = {"task": task.name, **asdict(config)}
    write_atomically(out / _PROGRESS, json.dumps({"run": run, "seconds": seconds}).encode())


def _progress(out: Path, task: Task, config: AgentConfig) -> float | None:
    """The seconds that the run in the folder took so far, or None where there is none."""
    path, told = out / _PROGRESS, json.loads(json.dumps({"task": task.name, **asdict(config)}))
    if not path.exists():
        return None
    found = read_json(path, _Progress, PwmGymError)
    was = found.run
    if other := sorted(key for key in {*was, *told} - {"threads", "minutes"} if was.get(key) != told.get(key)):
        before, now = ({key: each.get(key) for key in other} for each in (was, told))
        raise PwmGymError(f"{out} holds a run of {before}; expected {now}, or another folder")
    return found.seconds


def _scenes(task: Task, config: AgentConfig, out: Path, goes_on: bool) -> SceneBank | None:
    """What the model's episodes start from, drawn once a run."""
    if config.world != "model" or not config.scenes:
        return None
    path = out / _SCENES
    if not (goes_on and path.exists()):
        _draw(task, config).save(path)
    return SceneBank.load(path)


def _draw(task: Task, config: AgentConfig) -> SceneBank:
    """Scenes of the simulator's training seeds, or of a data set's demonstrations."""
    if not config.demonstrations:
        return simulated_bank(task, config.scenes)
    shown = load_demonstrations(config.demonstrations, "train", task.name)
    return underway_bank(shown, config.scenes, config.underway, config.seed)


def _learner(task: Task, config: AgentConfig, world: Any, out: Path) -> BaseAlgorithm:
    """A new algorithm, or the one that a killed run left."""
    kind: Any = algorithm_class(config.algorithm)
    if (path := out / _STATE).exists():
        try:
            return kind.load(path, world, device=config.device)
        except Exception as error:  # of a pickle: whatever it may be
            raise CheckpointError(f"{path} is truncated or foreign ({error}); delete it to start anew") from error
    shapes = policy_settings(task, config)
    learner = kind(policy_name(config), world, policy_kwargs=shapes, **config.settings())
    if config.init:
        learner.policy.load_state_dict(_begun(task, config, kind).policy.state_dict())
    return learner


def _begun(task: Task, config: AgentConfig, kind: Any) -> BaseAlgorithm:
    """The algorithm of the run that ``config.init`` names."""
    folder = Path(config.init)
    if not (folder / _PROGRESS).exists():
        raise CheckpointError(f"init={config.init!r} holds no run; expected a folder of pwm-gym train-agent")
    run = read_json(folder / _PROGRESS, _Progress, CheckpointError).run
    mine = {"task": task.name, **{key: getattr(config, key) for key in ("algorithm", "observation", "width")}}
    if other := {key: run.get(key) for key, value in mine.items() if run.get(key) != value}:
        wanted = {key: mine[key] for key in other}
        raise CheckpointError(f"init={config.init!r} is a run of {other}; expected {wanted}")
    try:
        return kind.load(folder / _STATE, device="cpu")
    except Exception as error:  # of a pickle: whatever it may be
        raise CheckpointError(f"{folder / _STATE} is missing, truncated or foreign ({error})") from error


class _Loggers(KVWriter):
    """Passes what stable-baselines3 logs on to :func:`pwm_gym.learning.logging_to`'s loggers."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Numbers by name."""
        tell_loggers(self.out, step, {k: float(v) for k, v in key_values.items() if is_number(v)})

    def close(self) -> None:
        """Nothing is open."""


class _Saver(BaseCallback):
    """Shows progress and saves the run: its state after each of PPO's updates that is due, and the policy beside it."""

    def __init__(
        self, learner: BaseAlgorithm, task: Task, config: AgentConfig, out: Path, spent: float, progress: bool
    ) -> None:
        super().__init__()
        self.model, self.task, self.config, self.out = learner, task, config, out
        self._spent, self._begun = spent, time.perf_counter()
        self._bar = tqdm(
            total=config.steps, unit="step", unit_scale=True, mininterval=1.0, desc="train", disable=not progress
        )
        self._saved = 0
        self._model_took = _model_took(task, config)

    def _on_training_start(self) -> None:
        self._saved = self.num_timesteps

    def _on_step(self) -> bool:
        self._bar.update(min(self.num_timesteps, self.config.steps) - self._bar.n)
        return not self.late

    @property
    def late(self) -> bool:
        """Whether the training took the minutes that it may take."""
        return 0.0 < 60.0 * self.config.minutes <= self._seconds()

    def _on_rollout_start(self) -> None:
        """An update is over."""
        infos = self.model.ep_success_buffer
        if infos:
            self._bar.set_postfix(success=f"{sum(infos) / len(infos):.2f}")
        every = self.config.snapshot_every
        if every and self.num_timesteps // every > self._saved // every:
            self._saved = self.num_timesteps
            self.save(self.out / "snapshots" / f"{self.num_timesteps:09d}")

    def _on_training_end(self) -> None:
        self._bar.close()

    def save(self, folder: Path | None = None) -> None:
        """Write the policy, and the state that the run goes on from."""
        told = self.told()
        save_agent(folder or self.out, self.model.policy, self.task, self.config, told)
        with replacing(self.out / _STATE) as file:
            self.model.save(file)
        _claim(self.out, self.task, self.config, told["seconds"])

    def told(self) -> dict[str, Any]:
        """What the training took so far."""
        return {"seconds": self._seconds(), "steps": self.model.num_timesteps, **self._model_took}

    def _seconds(self) -> float:
        return self._spent + time.perf_counter() - self._begun


def _model_took(task: Task, config: AgentConfig) -> dict[str, Any]:
    """Simulator steps of the world model's data, and minutes of its training."""
    if config.world != "model":
        return {}
    training = load_checkpoint(resolve(config.checkpoint, task.name)).description["training"]
    data = training.get("data") or {}
    return {"model_data_steps": data.get("transitions"), "model_minutes": training.get("minutes")}
