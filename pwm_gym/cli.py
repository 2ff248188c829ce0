"""The ``pwm-gym`` command, which stands beside the package so that its help is quick: :mod:`pwm_gym_cli`."""

from pwm_gym_cli import main

__all__ = ["main"]
