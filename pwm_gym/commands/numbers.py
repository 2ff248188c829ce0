"""Numbers of the command line that cannot be."""

from __future__ import annotations

from pwm_gym.errors import PwmGymError

__all__ = ["check_least"]


def check_least(command: object, **least: int) -> None:
    """Refuse options of a command that are less than ``least`` says.

    Raises:
        PwmGymError: naming the first one.
    """
    for name, smallest in least.items():
        if (value := getattr(command, name)) < smallest:
            raise PwmGymError(f"--{name.replace('_', '-')} {value}; expected at least {smallest}")
