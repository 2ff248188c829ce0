"""The loop of every training here: steps, averaged weights, curves, and a state that a killed run resumes from.

Every batch, and a network's own randomness, is a pure function of (seed, step, rank), so a killed run resumes to the
same result. Several processes (``torchrun``) share the work through PyTorch's DistributedDataParallel.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from torch import nn
from tqdm import tqdm

from pwm_gym.errors import CheckpointError, PwmGymError, unknown_name, writing
from pwm_gym.files import replacing
from pwm_gym.learning.clock import Clock
from pwm_gym.learning.loggers import tell_loggers
from pwm_gym.learning.optimizers import build_optimizer

__all__ = ["Draw", "LoopConfig", "has_state", "is_main_process", "run_training"]

_STATE = "training-state.pt"
_KEYS = {"config", "model", "optimizer", "ema", "step", "spent"}  # of the state

Draw = Callable[[torch.Generator, int, int], Any]
"""(generator, step, processes) -> this process's batch, which has ``to(device)``."""


_OPTIMIZERS = ("muon", "adamw")
_SCHEDULES = ("cosine", "step")
_TORCHRUN = ("RANK", "WORLD_SIZE", "MASTER_ADDR")


@dataclass(frozen=True)
class LoopConfig:
    """What every training is told; each kind of training adds its own.

    Raises:
        UnknownNameError: an optimiser or a schedule that is none.
    """

    phases: tuple[tuple[int, int, int], ...] = ((1, 1000, 32),)
    """(extent, optimiser steps, batch size), one after the other; each kind of training says what the extent is."""
    optimizer: str = "muon"
    """"muon" (on matrices of at least 32 x 32, AdamW on the rest) or "adamw"."""
    learning_rate: float = 3e-3
    """The optimiser's, at its highest."""
    weight_decay: float = 0.01
    """The optimiser's."""
    schedule: str = "cosine"
    """"cosine" (to 1 % over the whole run) or "step" (StepLR)."""
    step_size: int = 30
    """StepLR: epochs between drops."""
    gamma: float = 0.1
    """StepLR: factor of a drop."""
    epoch_steps: int = 1000
    """Optimiser steps that StepLR counts as one epoch."""
    gradient_clip: float = 1.0
    """Largest gradient norm."""
    ema_decay: float = 0.998
    """Decay of the weights' exponential moving average, which is what is saved; 0 saves the last weights."""
    seed: int = 0
    """Initial weights and batches."""
    threads: int = 2
    """PyTorch threads a process."""
    validate_every: int = 2000
    """Optimiser steps between validations; a checkpoint is saved then, too."""
    save_every: int = 250
    """Optimiser steps between saves of the state that a killed run resumes from."""
    device: str = "cpu"
    """PyTorch device."""

    def __post_init__(self) -> None:
        """Check the names."""
        for kind, known in (("optimizer", _OPTIMIZERS), ("schedule", _SCHEDULES)):
            if getattr(self, kind) not in known:
                raise unknown_name(kind, getattr(self, kind), known)

    @property
    def steps(self) -> int:
        """Optimiser steps in all."""
        return sum(steps for _, steps, _ in self.phases)

    def phase_index(self, step: int) -> int:
        """Place in ``phases`` of the one that ``step`` is in; steps past the end belong to the last."""
        for index, (_, steps, _) in enumerate(self.phases):
            if step < steps:
                return index
            step -= steps
        return len(self.phases) - 1

    def phase(self, step: int) -> tuple[int, int]:
        """(extent, batch size) at ``step``."""
        extent, _, batch = self.phases[self.phase_index(step)]
        return extent, batch

    def describe(self) -> str:
        """All settings, in an order that does not depend on the code's."""
        return ", ".join(f"{name}={value!r}" for name, value in sorted(asdict(self).items()))


def run_training(
    model: nn.Module,
    loss: nn.Module,
    draw: Draw,
    config: LoopConfig,
    folder: Path,
    validate: Callable[[Any], dict[str, float]],
    save: Callable[[nn.Module, dict[str, float]], None],
    progress: bool = True,
    clock: Clock | None = None,
) -> dict[str, float]:
    """Train ``model`` and return the last validation's metrics (empty in all processes but the first).

    Args:
        model: it is changed in place and holds the averaged weights at the end.
        loss: batch -> scalar; the model is a part of it.
        draw: this process's batch of a step.
        config: settings.
        folder: TensorBoard curves and the training state; a state found there is resumed.
        validate: metrics of a model.
        save: writes a checkpoint of a model with its metrics.
        progress: whether to show a bar.
        clock: counts what all sessions of the training took.
    """
    torch.set_num_threads(config.threads)
    run = _Run(model.to(config.device), loss, config, folder, clock or Clock())
    metrics: dict[str, float] = {}
    with tqdm(total=config.steps, initial=run.step, disable=not (progress and run.is_main), desc="train") as bar:
        while run.step < config.steps:
            value = run.update(draw)
            bar.update()
            if run.step % 50 == 0:
                run.log({"train/loss": value})
                bar.set_postfix(loss=f"{value:.4f}", **{k: f"{v:.4f}" for k, v in metrics.items()})
            if run.step % config.validate_every == 0 or run.step == config.steps:
                metrics = run.checkpoint(validate, save)
            elif run.step % config.save_every == 0:
                run.save_state()
    run.finish()
    return metrics


def is_main_process() -> bool:
    """Whether this is the first of the processes that train together: it alone validates and writes.

    Raises:
        PwmGymError: the environment tells a rank, but not how many processes there are or where they meet.
    """
    return _rank_and_world()[0] == 0


def _rank_and_world() -> tuple[int, int]:
    """This process's rank and the number of processes, as ``torchrun`` tells them."""
    told = {name: os.environ[name] for name in _TORCHRUN if os.environ.get(name)}
    if "RANK" not in told and "WORLD_SIZE" not in told:
        return 0, 1
    if missing := [name for name in _TORCHRUN if name not in told]:
        raise PwmGymError(
            f"RANK={told.get('RANK')}, WORLD_SIZE={told.get('WORLD_SIZE')} are set without {', '.join(missing)}; "
            "start several processes with torchrun, or unset them"
        )
    try:
        rank, world = int(told["RANK"]), int(told["WORLD_SIZE"])
    except ValueError:
        raise PwmGymError(f"RANK={told['RANK']}, WORLD_SIZE={told['WORLD_SIZE']}; expected integers") from None
    if not 0 <= rank < world:
        raise PwmGymError(f"RANK={rank}; expected 0 to {world - 1}, below WORLD_SIZE")
    return rank, world


def has_state(folder: Path) -> bool:
    """Whether a run in ``folder`` can be resumed."""
    return (folder / _STATE).exists()


class _Run:
    """One training run: optimiser, averaged weights, step count, and their state on disk."""

    def __init__(self, model: nn.Module, loss: nn.Module, config: LoopConfig, folder: Path, clock: Clock) -> None:
        self.config, self.folder, self.model, self.clock, self.step = config, folder, model, clock, 0
        self.rank, self.world = _rank_and_world()
        self.is_main = self.rank == 0
        if self.world > 1 and not dist.is_initialized():
            dist.init_process_group("nccl" if config.device.startswith("cuda") else "gloo")
        self.loss = loss
        if self.world > 1:
            self.loss = nn.parallel.DistributedDataParallel(self.loss)
        self.optimizer = build_optimizer(
            model, config.learning_rate, config.weight_decay, muon=config.optimizer == "muon"
        )
        self.ema = {k: v.detach().clone() for k, v in model.state_dict().items()}
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        self._resume()
        self._writer: Any = None

    def _resume(self) -> None:
        path = self.folder / _STATE
        if not path.exists():
            return
        try:
            state = torch.load(path, map_location=self.config.device, weights_only=True)
        except Exception as error:
            raise CheckpointError(f"{path} is truncated or foreign ({error}); delete it to start anew") from error
        if not isinstance(state, dict) or state.keys() != _KEYS:
            raise CheckpointError(
                f"{path} is foreign or of another version of pwm_gym; "
                "finish it with that one or delete it to start anew"
            )
        if state["config"] != self.config.describe():
            raise CheckpointError(f"{path} was written with {state['config']}; expected {self.config.describe()}")
        try:
            self.model.load_state_dict(state["model"])
            self.optimizer.load_state_dict(state["optimizer"])
        except (RuntimeError, ValueError, LookupError, TypeError) as error:
            raise CheckpointError(f"{path} does not fit this model ({error}); delete it to start anew") from error
        self.ema, self.step = state["ema"], state["step"]
        self.clock.resume(state["spent"])

    def update(self, draw: Draw) -> float:
        """One optimiser step; returns its loss."""
        seed = (self.config.seed * 1_000_003 + self.step) * 1_009 + self.rank
        generator = torch.Generator().manual_seed(seed)
        torch.manual_seed(seed)  # of a network's own randomness
        batch = draw(generator, self.step, self.world).to(self.config.device)
        self.optimizer.set_learning_rate(self._learning_rate())
        self.model.train()
        self.optimizer.zero_grad()
        loss = self.loss(batch)
        self._check_finite("loss", float(loss.detach()))
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.model.parameters(), self.config.gradient_clip)
        self._check_finite("gradient's norm", float(norm))
        self.optimizer.step()
        self.step += 1
        self._fold_ema()
        return float(loss.detach())

    def _check_finite(self, what: str, value: float) -> None:
        """Stop before what is not finite reaches the weights."""
        if math.isfinite(value):
            return
        number, (extent, batch) = self.config.phase_index(self.step) + 1, self.config.phase(self.step)
        raise PwmGymError(
            f"the {what} is {value} at step {self.step} of {self.config.steps} (phase {number}: extent {extent}, "
            f"batch {batch}); lower learning_rate={self.config.learning_rate} or gradient_clip="
            f"{self.config.gradient_clip}. What was saved before stays in {self.folder}"
        )

    def _learning_rate(self) -> float:
        c = self.config
        if c.schedule == "step":
            return c.learning_rate * c.gamma ** (self.step // c.epoch_steps // c.step_size)
        warm = min(1.0, (self.step + 1) / 200)
        done = torch.tensor(self.step / c.steps * torch.pi)
        return c.learning_rate * warm * (0.01 + 0.99 * 0.5 * (1 + float(torch.cos(done))))

    @torch.no_grad()
    def _fold_ema(self) -> None:
        decay = min(self.config.ema_decay, self.step / (self.step + 10))
        for name, value in self.model.state_dict().items():
            if value.is_floating_point():
                self.ema[name].lerp_(value, 1.0 - decay)
            else:
                self.ema[name].copy_(value)

    def log(self, values: dict[str, float]) -> None:
        """Append to the TensorBoard curves, and tell other loggers (the first process alone)."""
        if not self.is_main:
            return
        if self._writer is None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(self.folder / "tensorboard"), purge_step=self.step)
        for name, value in values.items():
            self._writer.add_scalar(name, value, self.step)
        tell_loggers(self.folder, self.step, values)

    def checkpoint(
        self, validate: Callable[[Any], dict[str, float]], save: Callable[[nn.Module, dict[str, float]], None]
    ) -> dict[str, float]:
        """Validate and save the averaged weights, and the state to resume from."""
        if not self.is_main:
            return {}
        last = {k: v.detach().clone() for k, v in self.model.state_dict().items()}
        self.model.load_state_dict(self.ema)
        self.model.eval()
        metrics = validate(self.model)
        save(self.model, metrics)
        self.model.load_state_dict(last)
        self.log({f"validation/{k}": v for k, v in metrics.items()})
        self.save_state()
        return metrics

    def save_state(self) -> None:
        """Save what a killed run resumes from (the first process alone)."""
        if not self.is_main:
            return
        state = {
            "config": self.config.describe(),
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "ema": self.ema,
            "step": self.step,
            "spent": self.clock.spent(),
        }
        with replacing(self.folder / _STATE, RuntimeError) as file:  # which PyTorch raises on a full disk
            torch.save(state, file)

    def finish(self) -> None:
        """Leave the averaged weights in the model and close what is open."""
        self.model.load_state_dict(self.ema)
        self.model.eval()
        if self._writer is not None:
            self._writer.close()
        if self.world > 1:
            dist.barrier()
            dist.destroy_process_group()
