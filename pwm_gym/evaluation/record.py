"""Results as JSON with the machine, commit and date that produced them."""

from __future__ import annotations

import json
import math
import os
import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch

from pwm_gym.files import write_atomically

__all__ = ["describe_commit", "describe_machine", "write_results"]

_CODE = (":(top)pwm_gym", ":(top)envs", ":(top)wrappers")  # what decides a result; another result's file does not


def describe_machine() -> dict[str, Any]:
    """Processor, cores, threads, GPU and versions."""
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "torch_threads": torch.get_num_threads(),
        "gpu": gpu,
        "python": platform.python_version(),
        "torch": torch.__version__,
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def describe_commit() -> str | None:
    """Commit of the source tree that this module lies in, with "+" where its packages have changes."""
    folder = Path(__file__).parent
    try:
        run = ["git", "-C", str(folder)]
        head = subprocess.run([*run, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True)
        status = [*run, "status", "--porcelain", "-uno", "--", *_CODE]
        changes = subprocess.run(status, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return head.stdout.strip() + ("+" if changes.stdout.strip() else "")


def write_results(path: Path, results: dict[str, Any]) -> None:
    """Write ``results`` to ``path`` beside the command, machine, commit and date; what is no finite number is null."""
    record = {
        "command": " ".join([_program(), shlex.join(sys.argv[1:])]).strip(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": describe_commit(),
        "machine": describe_machine(),
        **results,
    }
    text = json.dumps(_finite(record), indent=1, allow_nan=False)
    write_atomically(path, (text + "\n").encode())


def _finite(value: Any) -> Any:
    """Plain values, None in the place of what JSON has no number for."""
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    if value is None or isinstance(value, bool | int | str):
        return value
    number = float(value)
    return number if math.isfinite(number) else None


def _program() -> str:
    """What was started; ``python -m pwm_gym`` is told by the name that it is installed under."""
    path = Path(sys.argv[0])
    if path.name == "__main__.py":
        return "pwm-gym"
    return f"python {path.parent.name}/{path.name}" if path.suffix == ".py" else path.name
