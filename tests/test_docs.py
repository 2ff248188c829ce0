"""README snippets run, and generated pages are up to date."""

from __future__ import annotations

import importlib.util
import re
from functools import partial
from pathlib import Path

import gymnasium as gym
import pytest

from pwm_gym.collection import CollectConfig
from pwm_gym.costs import COSTS, GRASPS, SUCCESSES, get_cost
from pwm_gym.planning import execute
from pwm_gym.tasks import TASKS

ROOT = Path(__file__).parents[1]


def code_of(page):
    """The Python blocks of a page."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.S)
    assert blocks
    return blocks


def run_page(page, small=None):
    """Names that the Python blocks of a page define, run one after the other.

    Args:
        page: its path.
        small: line that takes the place of the one that sets the page's numbers.
    """
    blocks = code_of(page)
    if small is not None:
        name = small.partition("=")[0]
        blocks, counts = zip(*(re.subn(rf"^{re.escape(name)}=.*$", small, b, flags=re.M) for b in blocks), strict=True)
        assert sum(counts) == 1
    namespace: dict = {"__name__": "page"}
    for block in blocks:
        exec(compile(block, page, "exec", dont_inherit=True), namespace)
    return namespace


def test_readme_snippets_run(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert run_page("README.md")["info"]["cost_terms"]


@pytest.fixture
def kept_registries():
    """What a page registers is forgotten."""
    kept = [(registry, dict(registry)) for registry in (TASKS, COSTS, SUCCESSES, GRASPS, gym.registry)]
    yield
    for registry, before in kept:
        registry.clear()
        registry.update(before)


def test_a_task_of_ones_own_is_one_short_file(monkeypatch, tmp_path, kept_registries):
    monkeypatch.chdir(tmp_path)
    names = run_page("docs/own_task.md")
    assert "PushCube" in TASKS and names["twin"].unwrapped.task is TASKS["PushCube"]
    assert names["observation"]["points"].shape == (1200, 3)


def test_a_cost_of_ones_own_rewards_environments_and_batches(kept_registries):
    names = run_page("docs/own_cost.md")
    assert names["env"].unwrapped.rules.cost.name == "lift_cube"
    assert names["many"].unwrapped.rules.cost.name == "reach_cube"


def test_a_mujoco_model_of_ones_own_is_a_simulator():
    names = run_page("docs/mujoco.md")
    assert names["simulator"].assets() == ("pusher", "box")


def test_a_strangers_xml_becomes_data_a_model_and_a_plan(monkeypatch, tmp_path, kept_registries):
    monkeypatch.chdir(tmp_path)
    page = "docs/own_mujoco_task.md"
    small = "EPISODES, PHASES, SEEDS = 2, ((1, 6, 8), (5, 1, 8)), range(400_000, 400_001)"
    monkeypatch.setattr("pwm_gym.collection.CollectConfig", partial(CollectConfig, held_out=1))
    monkeypatch.setattr("pwm_gym.planning.execute", lambda *args, max_steps: execute(*args, max_steps=3))
    names = run_page(page, small)
    assert names["agent"].task is TASKS["PushBox"] and names["runs"][0].steps == 3
    assert (tmp_path / "runs/PushBox/checkpoint").is_dir()
    lines = [line for block in code_of(page) for line in block.splitlines() if line.strip()]
    assert len(lines) < 60


def test_a_sequence_of_ones_own_goes_from_stage_to_stage(kept_registries):
    assert list(dict.fromkeys(run_page("docs/stages.md")["stages"])) == ["left", "back", "finished"]


def test_the_page_of_stages_names_those_of_the_tasks():
    text = (ROOT / "docs/stages.md").read_text()
    for name in ("MugCleanup", "Coffee", "CoffeePreparation"):
        stages = ", ".join(f"`{stage}`" for stage in get_cost(TASKS[name].plan_cost).stage_names[:-1])
        assert f"| {name} | {stages} |" in text


@pytest.mark.parametrize("name", ["generate", "generate_tasks", "generate_results"])
def test_generated_pages_are_up_to_date(name, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))  # as Python does for a script
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text() == module.page(), f"run: python docs/{name}.py"


def test_readme_names_only_files_that_exist():
    links = re.findall(r"\]\((?!http)([^)#]+)\)", (ROOT / "README.md").read_text())
    assert links
    for link in links:
        assert (ROOT / link).exists(), link
