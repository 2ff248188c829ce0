"""Code on pages runs, generated pages are up to date, and the site has every page, task and link."""

from __future__ import annotations

import importlib
import re
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import gymnasium as gym
import pytest

import pwm_gym
from pwm_gym.collection import CollectConfig
from pwm_gym.costs import COSTS, GRASPS, SUCCESSES, get_cost
from pwm_gym.planning import execute
from pwm_gym.tasks import TASKS

ROOT = Path(__file__).parents[1]
PAGES = sorted(path.relative_to(ROOT).as_posix() for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])


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


def test_readme_snippets_run():
    assert run_page("README.md")["info"]["cost_terms"]


def test_every_block_of_readme_runs_alone():
    assert (ROOT / "README.md").read_text().count("```python") == 1


def test_the_quick_start_runs(monkeypatch, tmp_path, kept_registries):
    monkeypatch.chdir(tmp_path)
    names = run_page("docs/quick_start.md")
    assert names["many"].num_envs == 64 and (tmp_path / "run.npz").exists()
    assert names["info"]["completion_error"]["cube"] < 0.02  # metres


def test_a_frame_of_ones_own_camera_becomes_a_scene_and_a_plan(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = run_page("docs/own_camera.md")
    assert names["error"] < 0.01  # metres
    assert names["action"].shape == (7,) and (tmp_path / "view.npz").exists()


def test_an_agent_of_ones_own_learns_and_is_ranked(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = run_page("docs/train_agent.md")
    assert names["took"]["steps"] >= 128 and 0 < names["run"].steps <= 5
    assert [row["name"] for row in names["table"]["rows"]] == ["trained", "still"]


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


def test_a_robot_of_ones_own_and_a_model_of_it(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    names = run_page("docs/own_robot.md")
    assert names["LAYOUT"].names == ("palm", "finger", "cube") and names["LIFT"].driven == ("palm", "finger")
    assert "torch.Size([1, 200, 3])" in capsys.readouterr().out


def test_a_checkpoint_is_published_to_a_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = run_page("docs/publish.md")
    assert "PickCube" in names["checkpoint"].tasks and names["observation"] in names["env"].observation_space


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


@pytest.fixture
def docs(monkeypatch):
    """Imports a script of docs/ as Python runs it."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    return importlib.import_module


@pytest.mark.parametrize("name", ["generate", "generate_tasks", "generate_results", "generate_readme"])
def test_generated_pages_are_up_to_date(name, docs):
    module = docs(name)
    assert module.PAGE.read_text() == module.page(), f"run: python docs/{name}.py"


def test_the_site_has_every_page_once(docs):
    named = Counter(page for below in docs("site_pages").sections().values() for page in below)
    committed = {Path(page).stem for page in PAGES if page.startswith("docs/")} - {"index"}
    tasks = {f"tasks/{name}" for name in TASKS}
    assert {page for page in named if "/" not in page} == committed
    assert {page for page in named if page.startswith("tasks/")} == {*tasks, "tasks/index"}
    assert max(named.values()) == 1


@pytest.mark.parametrize("name", sorted(TASKS))
def test_every_task_has_a_page_with_its_spaces_and_its_terms(name, docs):
    task = TASKS[name]
    text = docs("task_page").task_page(task)
    assert f"`Box(-1.0, 1.0, ({task.action_size},), float32)`" in text
    assert f"| `points` | `({task.layout.points}, 3)` |" in text
    assert all(f"| `{entity.name}` | {entity.points} |" in text for entity in task.layout)
    terms = get_cost(task.cost).terms
    assert all(f"| `{term}` | {weight:+.3g} |" in text for term, (weight, _) in terms.items())
    assert all(f": {stage}\n" in text for stage in getattr(get_cost(task.plan_cost), "stage_names", ())[:-1])


def test_a_task_that_is_registered_has_a_page_at_once(docs, kept_registries):
    TASKS["Another"] = replace(TASKS["StackCube"], name="Another", description="Something else.")
    site = docs("site_pages")
    assert "tasks/Another" in site.sections()["tasks/index"]
    assert "Something else." in site.tasks_index()
    page = docs("task_page").task_page(TASKS["Another"])
    assert 'gym.make("pwm/Another-v0", checkpoint=' in page and "None are recorded yet." in page


def test_a_tasks_page_has_its_results_with_their_commands(docs):
    page = docs("task_page").task_page(TASKS["StackCube"])
    plan = docs("measured").measurements("plan", "StackCube")[0]
    assert plan.result["command"] in page
    assert f"| {plan.result['successes']} / {plan.result['episodes']} |" in page


def test_the_reference_has_every_public_package(docs):
    api = docs("api_page")
    assert {f"pwm_gym.{name}" for name in pwm_gym._SUBPACKAGES} < {*api.PUBLIC}
    text = api.api_page("pwm_gym.planning", importlib.import_module("pwm_gym.planning"))
    assert ".. autoclass:: pwm_gym.planning.Agent\n" in text and ".. autofunction:: pwm_gym.planning.execute\n" in text
    assert "PLANNERS" in text


def test_docstrings_become_markdown(docs):
    text = "What.\n\nArgs:\n    a: one,\n        more of :class:`it.It`.\n    b: two.\n\nExample:\n    >>> f(``x``)\n"
    told = docs("docstrings").google_to_markdown(text)
    assert "- `a`: one, more of `it.It`.\n- `b`: two.\n\n**Example**\n\n```pycon\n>>> f(``x``)\n```" in told


def test_markdown_docstrings_become_restructured_text(docs):
    lines = ["## Head", "", "| a | b |", "|---|---|", "| 1 | 2 |", "", "End."]
    told = docs("docstrings").markdown_to_rst(lines)
    assert [line for line in told if line] == [
        ".. rubric:: Head",
        ".. list-table::",
        "   :header-rows: 1",
        "   * - a",
        "     - b",
        "   * - 1",
        "     - 2",
        "End.",
    ]


def test_dead_links_of_a_built_site_are_found(docs, tmp_path):
    (tmp_path / "a.html").write_text('<h1 id="top"><a href="b.html#there">x</a><a href="https://x.org/y">y</a>')
    (tmp_path / "b.html").write_text('<p id="there"><a href="a.html#gone">x</a><img src="no.png"><a href="#there">')
    assert docs("check_links").dead_links(tmp_path) == ["b.html: a.html#gone", "b.html: no.png"]


def test_bars_in_docstrings_are_text(docs):
    escape = docs("docstrings").escape_bars
    assert escape("the greatest |R_i - R_j| of them") == r"the greatest \|R_i - R_j\| of them"
    assert escape("``int | None`` or ``str | None``") == "``int | None`` or ``str | None``"


@pytest.mark.parametrize("page", PAGES)
def test_pages_name_only_files_that_exist(page):
    for link in re.findall(r"\]\((?!http|#)([^)#\s]+)[^)]*\)", (ROOT / page).read_text()):
        assert (ROOT / page).parent.joinpath(link).exists(), link


def test_readme_links_into_the_docs():
    assert "](docs/quick_start.md)" in (ROOT / "README.md").read_text()
