"""Pages of the API reference: one a public module, whose text autodoc takes from the docstrings."""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
from types import ModuleType
from typing import Any

from docstrings import plain
from formatting import grid

PUBLIC = (
    "pwm_gym",
    "pwm_gym.envs",
    "pwm_gym.wrappers",
    "pwm_gym.scene",
    "pwm_gym.robots",
    "pwm_gym.sim",
    "pwm_gym.tasks",
    "pwm_gym.skills",
    "pwm_gym.costs",
    "pwm_gym.dynamics",
    "pwm_gym.planning",
    "pwm_gym.policies",
    "pwm_gym.agents",
    "pwm_gym.cameras",
    "pwm_gym.completion",
    "pwm_gym.perception",
    "pwm_gym.data",
    "pwm_gym.collection",
    "pwm_gym.training",
    "pwm_gym.evaluation",
    "pwm_gym.experiments",
    "pwm_gym.viewer",
    "pwm_gym.assets",
    "pwm_gym.errors",
)
_FURTHER = (
    "pwm_gym.wrappers.vector",
    "pwm_gym.agents.ranking",
    "pwm_gym.sim.maniskill",
    "pwm_gym.sim.mujoco",
    "pwm_gym.sim.cabinets",
    "pwm_gym.sim.coffee_machine",
    "pwm_gym.sim.props",
    "pwm_gym.agents.contestants",
    "pwm_gym.agents.ranking",
    "pwm_gym.planning.adapters",
    "pwm_gym.planning.constraints",
    "pwm_gym.planning.sampling",
    "pwm_gym.robots.gripper",
    "pwm_gym.dynamics.registry",
    "pwm_gym.cameras.viewpoints",
    "pwm_gym.scene.se3",
)
"""Modules that no ``__all__`` names."""


def modules() -> dict[str, ModuleType]:
    """Every module of the reference by name: the public ones, and the modules among their public names."""
    found: dict[str, ModuleType] = {}
    for name in (*PUBLIC, *_FURTHER):
        module = importlib.import_module(name)
        found[name] = module
        if name != "pwm_gym":  # whose public modules are listed above
            found |= {f"{name}.{part}": member for part, member in _members(module) if inspect.ismodule(member)}
    return dict(sorted(found.items()))


def _members(module: ModuleType) -> list[tuple[str, Any]]:
    return [(name, getattr(module, name)) for name in getattr(module, "__all__", ())]


def targets() -> dict[str, str]:
    """Where a class or function is defined -> under which name the reference shows it."""
    found = {}
    for module_name, module in modules().items():
        for name, member in _members(module):
            if module_name != "pwm_gym" and hasattr(member, "__qualname__"):
                found[f"{member.__module__}.{member.__qualname__}"] = f"{module_name}.{name}"
    return found


def api_page(name: str, module: ModuleType) -> str:
    """Markdown of a module's page, around directives of autodoc."""
    head = f"# {name}\n\n```{{eval-rst}}\n.. py:module:: {name}\n\n{_docstring(module)}\n```\n"
    if name == "pwm_gym":
        return head + "\n" + _names_of_the_top()
    told = documented_constants(module)
    directives = [text for member, value in _members(module) if (text := _directive(f"{name}.{member}", value))]
    directives += [f".. autodata:: {name}.{constant}\n   :no-value:" for constant in told]
    parts = [head, _constants(module, told), *(f"```{{eval-rst}}\n{text}\n```\n" for text in directives)]
    return "\n".join(part for part in parts if part)


def _docstring(module: ModuleType) -> str:
    return inspect.getdoc(module) or ""


def _directive(path: str, member: Any) -> str:
    if inspect.isclass(member):
        return f".. autoclass:: {path}\n   :members:\n   :member-order: bysource"
    return f".. autofunction:: {path}" if inspect.isroutine(member) else ""


def documented_constants(module: ModuleType) -> list[str]:
    """Public names that the module itself assigns, with a docstring below."""
    body = ast.parse(inspect.getsource(module)).body
    found = []
    for statement, below in itertools.pairwise(body):
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            assigned = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
            found += [target.id for target in assigned if isinstance(target, ast.Name)]
    return [name for name in getattr(module, "__all__", ()) if name in found]


def _constants(module: ModuleType, told: list[str]) -> str:
    """A line on what is neither class, function nor module, nor told below."""
    names = [
        f"`{member}`"
        for member, value in _members(module)
        if not (inspect.isclass(value) or inspect.isroutine(value) or inspect.ismodule(value) or member in told)
    ]
    return f"Constants and types: {', '.join(names)}.\n" if names else ""


def _names_of_the_top() -> str:
    """What ``import pwm_gym`` gives, with links to where it is told."""
    shown = targets()
    rows = []
    for name, member in _members(importlib.import_module("pwm_gym")):
        if inspect.ismodule(member):
            rows.append([f"{{py:mod}}`pwm_gym.{name}`", first_sentence(member)])
        else:
            home = shown[f"{member.__module__}.{member.__qualname__}"]
            role = "class" if inspect.isclass(member) else "func"
            rows.append([f"{{py:{role}}}`pwm_gym.{name} <{home}>`", first_sentence(member)])
    return grid(["name", "what it is"], rows)


def first_sentence(documented: Any) -> str:
    """First sentence of a docstring as Markdown."""
    paragraph = (inspect.getdoc(documented) or "").split("\n\n")[0]
    return plain(" ".join(paragraph.split()))


def api_index() -> str:
    """Markdown of the reference's index."""
    rows = [[f"[`{name}`]({name}.md)", first_sentence(module)] for name, module in modules().items()]
    about = "Made from the docstrings. Points are metres in the frame of the robot's base, time is in control steps.\n"
    return f"# API reference\n\n{about}\n{grid(['module', 'what it is'], rows)}"
