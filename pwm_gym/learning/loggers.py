"""Who else is told of a training's curves, beside TensorBoard."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pwm_gym.errors import PwmGymError

__all__ = ["Logger", "logging_to", "tell_loggers"]

Logger = Callable[[Path, int, Mapping[str, float]], None]
"""Takes the folder of a run, its step, and values by name."""
_LOGGERS: list[Logger] = []


@contextmanager
def logging_to(logger: Logger) -> Iterator[None]:
    """Trainings within the block tell ``logger`` their curves, too: losses, validation errors, an agent's rewards.

    Args:
        logger: called with the run's folder, the step, and values by name, as often as TensorBoard's files are written;
            of a training in several processes by the first alone. What it raises ends the training.

    Raises:
        PwmGymError: it cannot be called.

    Example:
        >>> seen = []
        >>> with logging_to(lambda folder, step, values: seen.append((step, values))):
        ...     tell_loggers(Path("runs/mine"), 20, {"loss": 0.5})
        >>> seen
        [(20, {'loss': 0.5})]
    """
    if not callable(logger):
        raise PwmGymError(f"logger {logger!r}; expected a function of folder, step and values")
    _LOGGERS.append(logger)
    try:
        yield
    finally:
        _LOGGERS.remove(logger)


def tell_loggers(folder: Path, step: int, values: Mapping[str, float]) -> None:
    """Pass on values of a run at a step."""
    for logger in _LOGGERS:
        logger(folder, step, dict(values))
