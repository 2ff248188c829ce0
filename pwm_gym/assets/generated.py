"""Twelve generated shapes that the Panda's gripper can lift, for a task that runs without a download.

Each is made of convex parts, so nothing needs to be cut. Lengths are in metres; each shape stands on the table as it is
written here, z up.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from pwm_gym.assets.folder import AssetFolder
from pwm_gym.assets.names import GENERATED_PREFIX
from pwm_gym.errors import look_up

__all__ = ["GENERATED_OBJECTS", "generated_assets", "generated_pieces"]

_VERSION = 1  # of the shapes: a change of theirs builds a new folder
_SIDES = 32  # of round parts
_Parts = list[trimesh.Trimesh]


def generated_assets(root: str | Path | None = None) -> AssetFolder:
    """Folder of the generated shapes, built on first use.

    Args:
        root: folder to build in; None for ``pwm_gym/shapes-v1`` in ``XDG_CACHE_HOME``, or in ``~/.cache``.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    folder = AssetFolder(cache / "pwm_gym" / f"shapes-v{_VERSION}" if root is None else Path(root).expanduser())
    for name in GENERATED_OBJECTS:
        if not folder.has(name):
            pieces = generated_pieces(name)
            folder.write(name, _surface(pieces), pieces)
    listed = folder.names() if folder.exists() else ()
    if not set(GENERATED_OBJECTS) <= set(listed):
        folder.write_info(sorted({*listed, *GENERATED_OBJECTS}))
    return folder


def generated_pieces(name: str) -> list[trimesh.Trimesh]:
    """Convex parts of a generated shape, with its bounding box centred at the origin.

    Raises:
        UnknownNameError: no shape has this name.
    """
    parts = look_up("generated shape", name, _SHAPES)()
    middle = trimesh.util.concatenate(parts).bounds.mean(0)
    return [trimesh.Trimesh(part.vertices - middle, part.faces, process=False) for part in parts]


def _surface(parts: _Parts) -> trimesh.Trimesh:
    return trimesh.boolean.union(parts, engine="manifold") if len(parts) > 1 else parts[0]


def _box(size: tuple[float, float, float], at: tuple[float, float, float]) -> trimesh.Trimesh:
    """Box whose middle is ``at``."""
    box = trimesh.creation.box(size)
    box.apply_translation(at)
    return box


def _turned(profile: list[tuple[float, float]], sides: int = _SIDES) -> trimesh.Trimesh:
    """Convex hull of rings about z, one for each radius and height of the profile."""
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = [np.stack([r * np.cos(angle), r * np.sin(angle), np.full(sides, z)], -1) for r, z in profile]
    return trimesh.Trimesh(np.concatenate(rings)).convex_hull


def _laid(part: trimesh.Trimesh) -> trimesh.Trimesh:
    """The part laid on its side, along x."""
    turned = Rotation.from_euler("y", 90, degrees=True).apply(part.vertices)
    return trimesh.Trimesh(turned, part.faces, process=False)


def _ball(radius: float) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(2, radius).convex_hull


def _bottle() -> _Parts:
    body = _turned([(0.031, 0.0), (0.031, 0.085)])
    shoulder = _turned([(0.031, 0.085), (0.012, 0.105)])
    neck = _turned([(0.012, 0.105), (0.012, 0.135)])
    return [body, shoulder, neck]


def _jar() -> _Parts:
    belly = _turned([(0.022, 0.0), (0.035, 0.02), (0.035, 0.045), (0.024, 0.06)])
    lid = _turned([(0.028, 0.06), (0.028, 0.075)])
    return [belly, lid]


def _dumbbell() -> _Parts:
    weight = [(0.024, -0.012), (0.024, 0.012)]
    ends = [_laid(_turned(weight)), _laid(_turned(weight))]
    ends[0].apply_translation([-0.05, 0.0, 0.0])
    ends[1].apply_translation([0.05, 0.0, 0.0])
    return [*ends, _laid(_turned([(0.011, -0.04), (0.011, 0.04)]))]


_SHAPES: dict[str, Callable[[], _Parts]] = {
    "box": lambda: [_box((0.06, 0.045, 0.07), (0.0, 0.0, 0.035))],
    "bar": lambda: [_box((0.14, 0.028, 0.03), (0.0, 0.0, 0.015))],
    "brick": lambda: [_box((0.1, 0.065, 0.04), (0.0, 0.0, 0.02))],
    "cylinder": lambda: [_turned([(0.03, 0.0), (0.03, 0.09)])],
    "disc": lambda: [_turned([(0.034, 0.0), (0.034, 0.028)])],
    "ball": lambda: [_ball(0.032)],
    "hexagon": lambda: [_turned([(0.032, 0.0), (0.032, 0.05)], sides=6)],
    "cone": lambda: [_turned([(0.034, 0.0), (0.016, 0.08)])],
    "bottle": _bottle,
    "jar": _jar,
    "corner": lambda: [_box((0.1, 0.03, 0.035), (0.0, 0.0, 0.0175)), _box((0.03, 0.06, 0.035), (0.035, 0.045, 0.0175))],
    "dumbbell": _dumbbell,
}
_SHAPES = {GENERATED_PREFIX + name: make for name, make in _SHAPES.items()}

GENERATED_OBJECTS = tuple(sorted(_SHAPES))
"""Names of the generated shapes; all begin with "shape_"."""
