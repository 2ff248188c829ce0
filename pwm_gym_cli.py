"""The ``pwm-gym`` command; each subcommand is a dataclass in :mod:`pwm_gym.commands`.

This module stands beside the package: importing anything inside it registers the environments, for which PyTorch and
Gymnasium are imported. ``pwm-gym --help`` and ``--version`` need neither, and answer at once.
"""

from __future__ import annotations

import ast
import difflib
import errno
import importlib
import importlib.util
import os
import re
import select
import shutil
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

__all__ = ["COMMANDS", "main"]

COMMANDS = (
    "demo",
    "envs",
    "collect",
    "data",
    "train",
    "train-agent",
    "rank",
    "complete",
    "evaluate",
    "plan",
    "view",
    "bench",
    "scenes",
    "average",
    "check-cost",
    "publish",
    "assets",
)
"""Names of the subcommands. ``check-cost`` is the class ``CheckCost`` of ``pwm_gym/commands/check_cost.py``."""

_NOT_WRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.ENOTDIR, errno.EISDIR)
_USAGE = "usage: pwm-gym [-h] [--version] COMMAND [OPTIONS]"
_COLUMN = 14  # of the table of commands


def main(args: Sequence[str] | None = None) -> None:
    """Run a subcommand; errors about its input are one line, without a traceback."""
    try:
        _tell(args)
    except BrokenPipeError:
        if not _reader_left():  # a worker of the command's own
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more when it ends
        raise SystemExit(1) from None


def _tell(args: Sequence[str] | None) -> None:
    """Run a subcommand, and write all that it printed."""
    try:
        _main(args)
    except SystemExit as end:
        if not end.code:
            sys.stdout.flush()
        raise
    sys.stdout.flush()


def _reader_left() -> bool:
    """Whether nobody reads the output any more: ``pwm-gym rank --help | head``."""
    watched = select.poll()
    watched.register(sys.stdout.fileno(), 0)
    return any(what & select.POLLERR for _, what in watched.poll(0))


def _main(args: Sequence[str] | None) -> None:
    given = list(sys.argv[1:] if args is None else args)
    if not given:
        print(_help(), file=sys.stderr)
        raise SystemExit(2)
    first, *rest = given
    if first in ("-h", "--help"):
        print(_help())
        raise SystemExit(0)
    if first == "--version":
        print(f"pwm-gym {_version()}")
        raise SystemExit(0)
    if first not in COMMANDS:
        _fail(first)
    _run(first, rest)


def _run(name: str, args: Sequence[str]) -> None:
    import tyro

    from pwm_gym.commands.folders import check_outputs
    from pwm_gym.errors import PwmGymError

    module = importlib.import_module(f"pwm_gym.commands.{_module(name)}")
    try:
        command: Any = tyro.cli(getattr(module, _class(name)), prog=f"pwm-gym {name}", args=args)
        check_outputs(command)
        command.run()
    except PwmGymError as error:
        raise SystemExit(f"pwm-gym: {error}") from None
    except OSError as error:
        if error.errno not in (*_NOT_WRITABLE, *_FORBIDDEN):
            raise
        told = "written" if error.errno in _NOT_WRITABLE else "read or written"
        raise SystemExit(f"pwm-gym: {error.filename or 'a file'} cannot be {told} ({error.strerror})") from None


def _fail(name: str) -> NoReturn:
    near = difflib.get_close_matches(name, COMMANDS, n=1)
    hint = f" Did you mean '{near[0]}'?" if near else ""
    raise SystemExit(f"pwm-gym: unknown command {name!r}; known: {', '.join(COMMANDS)}.{hint}")


def _module(name: str) -> str:
    return name.replace("-", "_")


def _class(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("-"))


def _package() -> Path:
    """Folder of the package, which is not imported."""
    spec = importlib.util.find_spec("pwm_gym")
    if spec is None or spec.origin is None:
        raise SystemExit("pwm-gym: the package pwm_gym is not installed")
    return Path(spec.origin).parent


def _version() -> str:
    found = re.search(r'^__version__ = "(.+)"$', (_package() / "__init__.py").read_text(), re.M)
    return found[1] if found else "unknown"


def _help() -> str:
    """Usage and the first paragraph of each command's docstring."""
    folder = _package() / "commands"
    width = max(shutil.get_terminal_size().columns, 60)
    lines = [_USAGE, "", "3D point world models as Gymnasium environments, each with a simulator-backed twin.", ""]
    for name in COMMANDS:
        text = _summary(folder / f"{_module(name)}.py", _class(name))
        first, other = f"  {name:{_COLUMN}s}", " " * (_COLUMN + 2)
        lines += textwrap.wrap(
            text, width, initial_indent=first, subsequent_indent=other, break_on_hyphens=False
        )  # fmt: skip
    return "\n".join([*lines, "", "`pwm-gym COMMAND --help` tells a command's options."])


def _summary(path: Path, name: str) -> str:
    """First paragraph of a class's docstring, read from its file."""
    classes = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.ClassDef)]
    text = next((ast.get_docstring(node) for node in classes if node.name == name), None) or ""
    return " ".join(text.split("\n\n")[0].split())
