"""README snippets run, and generated pages are up to date."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import gymnasium as gym
import pytest

from pwm_gym.costs import COSTS, GRASPS, SUCCESSES, get_cost
from pwm_gym.tasks import TASKS

ROOT = Path(__file__).parents[1]


def run_page(page):
    """Names that the Python blocks of a page define, run one after the other."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.S)
    assert blocks
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


def test_data_go_to_other_libraries_and_come_back(monkeypatch, tmp_path):
    pytest.importorskip("pyarrow")
    pytest.importorskip("torchrl")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    names = run_page("docs/data.md")
    assert names["dataset"].total_episodes == 4 and names["twin"].spec.id == "pwm/PickCubeSim-v0"
    assert (names["copy"] / "dataset.json").exists() and (names["out"] / "meta" / "info.json").exists()
    assert names["found"].shape == (1, 4) and names["rolled"].shape == (4, 2)


def test_a_mujoco_model_of_ones_own_is_a_simulator():
    names = run_page("docs/mujoco.md")
    assert names["simulator"].assets() == ("pusher", "box")


def test_the_viewers_page_writes_a_page_and_a_film(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    run_page("docs/viewer.md")
    assert "My run" in (tmp_path / "run.html").read_text() and list(tmp_path.glob("films/*.mp4"))


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
