"""The ``pwm-gym`` command; each subcommand is a dataclass in :mod:`pwm_gym.commands`."""

from __future__ import annotations

from typing import Annotated, Any

import tyro

from pwm_gym.commands.assets import Assets
from pwm_gym.commands.bench import Bench
from pwm_gym.commands.check_cost import CheckCost
from pwm_gym.commands.collect import Collect
from pwm_gym.commands.complete import Complete
from pwm_gym.commands.demo import Demo
from pwm_gym.commands.envs import Envs
from pwm_gym.commands.evaluate import Evaluate
from pwm_gym.commands.plan import Plan
from pwm_gym.commands.publish import Publish
from pwm_gym.commands.rank import Rank
from pwm_gym.commands.scenes import Scenes
from pwm_gym.commands.train import Train
from pwm_gym.commands.train_agent import TrainAgent
from pwm_gym.commands.view import View
from pwm_gym.errors import PwmGymError

__all__ = ["main"]

Command = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Envs, tyro.conf.subcommand("envs")]
    | Annotated[Collect, tyro.conf.subcommand("collect")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[TrainAgent, tyro.conf.subcommand("train-agent")]
    | Annotated[Rank, tyro.conf.subcommand("rank")]
    | Annotated[Complete, tyro.conf.subcommand("complete")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Plan, tyro.conf.subcommand("plan")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[Scenes, tyro.conf.subcommand("scenes")]
    | Annotated[CheckCost, tyro.conf.subcommand("check-cost")]
    | Annotated[Publish, tyro.conf.subcommand("publish")]
    | Annotated[Assets, tyro.conf.subcommand("assets")]
)


def main(args: list[str] | None = None) -> None:
    """Run a subcommand; errors about its input are one line, without a traceback."""
    try:
        command: Any = tyro.cli(Command, prog="pwm-gym", args=args)
        command.run()
    except PwmGymError as error:
        raise SystemExit(f"pwm-gym: {error}") from None
