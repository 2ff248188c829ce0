"""Pages of the site that are made when it is built: environments, API reference, and the project's own files."""

from __future__ import annotations

import re
from pathlib import Path

from api_page import api_index, api_page, modules
from task_page import IMAGES, task_page

from pwm_gym.tasks import TASKS

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("tasks", "api", "project")
"""What is written into the folder of the sources, and not committed."""
PROJECT = {"architecture": "ARCHITECTURE.md", "contributing": "CONTRIBUTING.md", "changelog": "CHANGELOG.md"}
"""Page -> file in the repository's root."""


def write_pages(folder: Path) -> None:
    """Write every generated page below ``folder``; what is the same already keeps its time, and old pages go."""
    wanted = all_pages()
    for made in FOLDERS:
        for path in (folder / made).glob("*.md"):
            if path.relative_to(folder).as_posix() not in wanted:
                path.unlink()
    for name, text in wanted.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def all_pages() -> dict[str, str]:
    """File below the docs' folder -> its Markdown."""
    pages = {f"tasks/{name}.md": task_page(task) for name, task in TASKS.items()}
    pages["tasks/index.md"] = tasks_index()
    pages |= {f"api/{name}.md": api_page(name, module) for name, module in modules().items()}
    pages["api/index.md"] = api_index()
    pages |= {f"project/{page}.md": project_page(file) for page, file in PROJECT.items()}
    pages["project/index.md"] = project_index()
    return pages


def tasks_index() -> str:
    """Cards of all environments, and the pages that tell what they share."""
    cards = "\n".join(_card(name) for name in TASKS)
    tree = "\n".join([*TASKS, "All tasks on one page <../tasks>", "Spaces, infos, wrappers <../environments>"])
    return f"""# Environments

Each task is two environments with the same spaces: `pwm/NAME-v0` is the learned model, `pwm/NAMESim-v0` the simulator.
What they share: [spaces, infos and wrappers](../environments.md). [All tasks on one page](../tasks.md).

::::{{grid}} 1 2 2 3
:gutter: 3

{cards}
::::

```{{toctree}}
:hidden:

{tree}
```
"""


def _card(name: str) -> str:
    image = f":img-top: ../images/{name}.png\n" if (IMAGES / f"{name}.png").exists() else ""
    return f":::{{grid-item-card}} {name}\n:link: {name}\n:link-type: doc\n{image}\n{TASKS[name].description}\n:::\n"


def project_page(file: str) -> str:
    """A file of the repository's root, its links as they are from a folder of the site."""
    text = (ROOT / file).read_text()
    for page, other in PROJECT.items():
        text = text.replace(f"]({other})", f"]({page}.md)")
    return re.sub(r"\]\((?!http|#|\w+\.md\))(?:docs/)?([^)]+)\)", _from_a_folder, text)


def _from_a_folder(link: re.Match[str]) -> str:
    inside = (ROOT / "docs" / link[1].partition("#")[0]).exists()
    return f"](../{'' if inside else '../'}{link[1]})"


def project_index() -> str:
    """Index of the pages on the project itself."""
    tree = "\n".join(PROJECT)
    return f"""# Project

- [Architecture](architecture.md): what happens in a step, the order of the packages, where new things go.
- [Contributing](contributing.md): how a change is made and tested.
- [Changelog](changelog.md).
- Licence: Apache-2.0; what the shipped weights were trained on: [NOTICE](../../NOTICE).

```{{toctree}}
:hidden:

{tree}
```
"""
