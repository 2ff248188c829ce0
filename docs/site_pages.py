"""Pages that are made when the site is built: landing page, environments, API reference, the project's own files."""

from __future__ import annotations

import re
from pathlib import Path

from api_page import api_index, api_page, modules
from task_page import IMAGES, task_page

from pwm_gym.tasks import TASKS

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PROJECT = {"architecture": "ARCHITECTURE.md", "contributing": "CONTRIBUTING.md", "changelog": "CHANGELOG.md"}
"""Page -> file in the repository's root."""
_MADE = ("index.md", "tasks/*.md", "api/*.md", "project/*.md")
"""What is written among the sources, and not committed."""
_CARDS = {
    "quick_start": ("Quick start", "Install it, step a model, plan in it, and execute the plan in the simulator."),
    "tasks/index": ("Environments", "Every task: spaces, entities, rewards, stages, starting states, results."),
    "tutorials": ("Tutorials", "A cost, a task, a MuJoCo model, a camera or a world model of your own."),
    "concepts": ("Concepts", "Scenes, world models, costs, planners, completion; a glossary."),
    "results": ("Results", "Rollouts, planning, baselines and speed, each figure with its command."),
    "api/index": ("API reference", "Every public class and function, from its docstring."),
}
_TITLES = {"tasks": "All tasks on one page", "environments": "Spaces, infos, wrappers"}
"""What the table of contents calls a page, where that is not its own heading."""
_LANDING = """# pwm_gym

Learned **3D point world models as Gymnasium environments**, each with a simulator-backed twin: plan or learn in the
model, and see at once how far it agrees with the truth.

:::{{div}} hero
![PickCube: planned in the world model (teal), executed in the simulator (purple)](images/twin.gif)
:::

It is what `pwm-gym demo` draws: a plan made in the world model, executed in the simulator, and predicted from the first
scene alone.

```python
import gymnasium as gym
import pwm_gym

env = gym.make("pwm/PickCube-v0")  # the learned model
twin = gym.make("pwm/PickCubeSim-v0")  # the same task in the simulator
observation, info = env.reset(seed=0)
observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
```

::::{{grid}} 1 2 2 3
:gutter: 3

{cards}
::::
"""


def sections() -> dict[str, list[str]]:
    """Page -> the pages below it, in their order: the site's table of contents, in which every page stands once."""
    return {
        "index": [*_CARDS, "project/index"],
        "quick_start": ["viewer", "troubleshooting"],
        "tasks/index": [*(f"tasks/{name}" for name in TASKS), "tasks", "environments"],
        "tutorials": [
            "own_cost",
            "own_task",
            "own_robot",
            "own_mujoco_task",
            "mujoco",
            "own_camera",
            "train_model",
            "train_agent",
            "data",
            "stages",
            "publish",
        ],
        "concepts": ["models", "completion", "ycb"],
        "results": ["performance"],
        "api/index": [f"api/{name}" for name in modules()],
        "project/index": [f"project/{page}" for page in PROJECT],
    }


def toctree(pages: list[str]) -> str:
    """The directive that the site puts below a page, so that committed Markdown has none."""
    entries = [f"{_TITLES[page]} </{page}>" if page in _TITLES else f"/{page}" for page in pages]
    return "\n```{toctree}\n:hidden:\n\n" + "\n".join(entries) + "\n```\n"


def write_pages() -> None:
    """Write the generated pages; one that is the same keeps its time, and those of tasks that are gone go."""
    wanted = {DOCS / name: text for name, text in all_pages().items()}
    for pattern in _MADE:
        for old in {*DOCS.glob(pattern)} - wanted.keys():
            old.unlink()
    for path, text in wanted.items():
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def all_pages() -> dict[str, str]:
    """File below the docs' folder -> its Markdown."""
    pages = {"index.md": landing(), "tasks/index.md": tasks_index(), "project/index.md": project_index()}
    pages |= {f"tasks/{name}.md": task_page(task) for name, task in TASKS.items()}
    pages |= {f"project/{page}.md": project_page(file) for page, file in PROJECT.items()}
    pages |= {f"api/{name}.md": api_page(name, module) for name, module in modules().items()}
    return pages | {"api/index.md": api_index()}


def landing() -> str:
    """The first page: a moving picture, a few lines of code, and cards of the sections."""
    return _LANDING.format(cards="\n".join(_card(page, title, told) for page, (title, told) in _CARDS.items()))


def tasks_index() -> str:
    """Cards of all environments, and the pages that tell what they share."""
    cards = "\n".join(_card(f"tasks/{name}", name, task.description, name) for name, task in TASKS.items())
    return f"""# Environments

Each task is two environments with the same spaces: `pwm/NAME-v0` is the learned model, `pwm/NAMESim-v0` the simulator.
What they share: [spaces, infos and wrappers](../environments.md). [All tasks on one page](../tasks.md).

::::{{grid}} 1 2 2 3
:gutter: 3

{cards}
::::
"""


def _card(page: str, title: str, told: str, picture: str = "") -> str:
    image = f":img-top: /images/{picture}.png\n" if picture and (IMAGES / f"{picture}.png").exists() else ""
    return f":::{{grid-item-card}} {title}\n:link: /{page}\n:link-type: doc\n{image}\n{told}\n:::\n"


def project_page(file: str) -> str:
    """A file of the repository's root, its links as they are from a folder of the site."""
    text = (ROOT / file).read_text()
    for page, other in PROJECT.items():
        text = text.replace(f"]({other})", f"]({page}.md)")
    return re.sub(r"\]\((?!http|#|\w+\.md\))([^)]+)\)", _from_a_folder, text)


def _from_a_folder(link: re.Match[str]) -> str:
    """A link from the repository's root, seen from a folder of the docs."""
    below = link[1].removeprefix("docs/")
    return f"](../{below})" if below != link[1] else f"](../../{link[1]})"


def project_index() -> str:
    """Index of the pages on the project itself."""
    return """# Project

- [Architecture](architecture.md): what happens in a step, the order of the packages, where new things go.
- [Contributing](contributing.md): how a change is made and tested.
- [Changelog](changelog.md): what is new.
- Licence: Apache-2.0; what the shipped weights were trained on: [NOTICE](../../NOTICE).
"""
