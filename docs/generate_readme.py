"""Write the tables and figures of README.md from the registry and the results: python docs/generate_readme.py.

The rest of README.md is written by hand; what is written here stands between two comments that name it.
"""

from __future__ import annotations

import re

from agents import in_short
from formatting import ROOT, grid
from glance import HEADLINE_HEAD, headline
from task_parts import trained_on

from pwm_gym.tasks import TASKS, Task

PAGE = ROOT / "README.md"


def page() -> str:
    """README.md with its tables and figures as they should be."""
    text = PAGE.read_text()
    parts = {"environments": _environments(), "results": grid(HEADLINE_HEAD, headline()), "agents": in_short()}
    for name, part in parts.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        block = f"{begin}\n{part}\n{end}"
        text, count = re.subn(f"{begin}.*{end}", lambda _, block=block: block, text, flags=re.S)
        if count != 1:
            raise ValueError(f"README.md has {count} parts {name!r}; expected one between its two comments")
    return text


def _environments() -> str:
    return grid(["environments", "task", "robot", "points", "checkpoint"], [_row(task) for task in TASKS.values()])


def _row(task: Task) -> list[str]:
    names = f"`pwm/{task.name}-v0`, `pwm/{task.name}Sim-v0`"
    seen = trained_on(task.name)
    checkpoint = "-" if not seen else "yes" if task.name in seen else "yes, never trained on it"
    told = f"[{task.description}](docs/tasks.md#{task.name.lower()})"
    return [names, told, task.robot.name, str(task.layout.points), checkpoint]


if __name__ == "__main__":
    PAGE.write_text(page())
