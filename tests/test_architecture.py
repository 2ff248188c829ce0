"""Imports run the way that ARCHITECTURE.md says."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {"pwm_gym": ROOT / "pwm_gym", "pwm_gym.envs": ROOT / "envs", "pwm_gym.wrappers": ROOT / "wrappers"}


def layers():
    """Package or module of ``pwm_gym`` -> its line in the list, 0 at the bottom."""
    text = (ROOT / "ARCHITECTURE.md").read_text().split("## Which way imports run")[1].split("\n## ")[0]
    lines = re.findall(r"^- (.*)$", text, re.M)
    return {name: k for k, line in enumerate(reversed(lines)) for name in re.findall(r"`(\w+)`", line)}


def modules():
    """(module, its tree) of every file."""
    for package, folder in FOLDERS.items():
        for path in sorted(folder.rglob("*.py")):
            yield ".".join([package, *path.relative_to(folder).with_suffix("").parts]), ast.parse(path.read_text())


def imported(tree):
    """Modules of the package that a file imports at run time, inside functions, too."""
    for_types = {
        id(child)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for child in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in for_types:
            continue
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "pwm_gym":
            yield node.module
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name.split(".")[0] == "pwm_gym")


def part(module):
    """What of ``pwm_gym`` a module belongs to."""
    names = module.split(".")
    return names[1] if len(names) > 1 else "__init__"


LAYERS = layers()
MODULES = dict(modules())


def test_the_list_is_whole():
    assert len(MODULES) > 150
    assert {part(module) for module in MODULES} == set(LAYERS)


@pytest.mark.parametrize("name", sorted(LAYERS))
def test_imports_run_downwards(name):
    upward = [
        f"{module} imports {other}"
        for module, tree in MODULES.items()
        if part(module) == name
        for other in imported(tree)
        if part(other) != name and other != "pwm_gym" and LAYERS[part(other)] >= LAYERS[name]
    ]
    assert not upward, "\n".join(upward)


def test_few_parts_import_the_whole_package():
    whole = {part(module) for module, tree in MODULES.items() if "pwm_gym" in imported(tree)}
    assert whole <= {"commands", "experiments", "collection"}, whole
