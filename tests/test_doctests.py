"""The examples in docstrings run; those marked ``+SKIP`` need files, simulators or minutes."""

import doctest
import importlib
from pathlib import Path

import pytest

import pwm_gym
from pwm_gym.costs import COSTS

PACKAGE = Path(pwm_gym.__file__).parent
FOLDERS = {"pwm_gym": PACKAGE} | {
    f"pwm_gym.{name}": Path(importlib.import_module(f"pwm_gym.{name}").__file__).parent for name in ("envs", "wrappers")
}


def modules():
    """Names of the modules that have examples which are not all skipped."""
    for package, folder in FOLDERS.items():
        for path in sorted(folder.rglob("*.py")):
            lines = path.read_text().splitlines()
            if any(">>> " in line and "+SKIP" not in line for line in lines):
                parts = path.relative_to(folder).with_suffix("").parts
                yield ".".join([package, *(part for part in parts if part != "__init__")])


MODULES = sorted(set(modules()))


@pytest.mark.parametrize("name", MODULES)
def test_examples_of_docstrings_run(name):
    before = dict(COSTS)
    try:
        module = importlib.import_module(name)
        failed, tried = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    finally:
        COSTS.clear()
        COSTS.update(before)
    assert tried and not failed


def test_there_are_examples_everywhere():
    assert len(MODULES) >= 14
    assert {"pwm_gym", "pwm_gym.errors", "pwm_gym.wrappers.chunks"} <= set(MODULES)
