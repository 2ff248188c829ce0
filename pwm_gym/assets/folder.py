"""The folder of objects that ManiSkill's PickSingleYCB reads."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from pwm_gym.errors import PwmGymError
from pwm_gym.files import write_atomically

__all__ = ["DENSITY", "AssetFolder"]

DENSITY = 1000.0  # kg/m^3: what ManiSkill takes for an object without a density
_LAYOUT = Path("data") / "assets" / "mani_skill2_ycb"


@dataclass(frozen=True)
class AssetFolder:
    """A root folder as ``MS_ASSET_DIR`` names it, with the objects of ManiSkill's YCB layout in it.

    ``<root>/data/assets/mani_skill2_ycb`` holds ``info_pick_v0.json`` and, for each object, ``models/<name>`` with
    ``collision.ply`` (its convex pieces together) and ``textured.obj`` (its surface). Lengths are in metres.
    """

    root: Path

    @property
    def base(self) -> Path:
        """Folder of the objects."""
        return self.root / _LAYOUT

    @property
    def info_path(self) -> Path:
        """File that lists the objects."""
        return self.base / "info_pick_v0.json"

    def model(self, name: str) -> Path:
        """Folder of one object."""
        return self.base / "models" / name

    def exists(self) -> bool:
        """Whether a list of objects is there."""
        return self.info_path.is_file()

    def names(self) -> tuple[str, ...]:
        """Listed objects, in alphabetical order.

        Raises:
            PwmGymError: the list is missing or unreadable.
        """
        return tuple(sorted(self.info()))

    def info(self) -> dict[str, Any]:
        """Listed objects with their box, scale and density.

        Raises:
            PwmGymError: the list is missing or unreadable.
        """
        try:
            return dict(json.loads(self.info_path.read_text()))
        except (OSError, TypeError, ValueError) as error:
            raise PwmGymError(f"{self.info_path} is no readable list of objects ({error})") from error

    def has(self, name: str) -> bool:
        """Whether the object's files are all there."""
        return all((self.model(name) / file).is_file() for file in ("textured.obj", "collision.ply"))

    def write(self, name: str, surface: trimesh.Trimesh, pieces: list[trimesh.Trimesh]) -> None:
        """Write an object's files; the list is written by :meth:`write_info`."""
        folder = self.model(name)
        write_atomically(folder / "textured.obj", surface.export(file_type="obj", include_normals=False).encode())
        # as text: SAPIEN's reader skips leading bytes of a binary file that look like white space, and crashes
        together = trimesh.util.concatenate(pieces).export(file_type="ply", encoding="ascii")
        write_atomically(folder / "collision.ply", together)

    def write_info(self, names: list[str]) -> None:
        """Write the list of objects, of the files that are there; what it says of an object stays."""
        known = self.info() if self.exists() else {}
        info = {name: known.get(name) or self._entry(name) for name in sorted(names)}
        write_atomically(self.info_path, json.dumps(info, indent=2).encode())

    def pieces(self, name: str) -> list[trimesh.Trimesh]:
        """Convex pieces of an object, in its canonical frame.

        Raises:
            PwmGymError: they are missing or unreadable.
        """
        return list(self._read(name, "collision.ply").split(only_watertight=False))

    def _entry(self, name: str) -> dict[str, Any]:
        low, high = self._read(name, "textured.obj").bounds
        return {"bbox": {"min": low.tolist(), "max": high.tolist()}, "scales": [1.0], "density": DENSITY}

    def _read(self, name: str, file: str) -> trimesh.Trimesh:
        path = self.model(name) / file
        try:
            mesh = trimesh.load(path, force="mesh", process=False)
        except Exception as error:  # each format's reader has its own errors
            raise PwmGymError(f"{path} is no readable mesh ({error})") from error
        if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
            raise PwmGymError(f"{path} has no faces, or vertices that are not finite")
        if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
            raise PwmGymError(f"{path} has faces of vertices that it lacks; expected 0 to {len(mesh.vertices) - 1}")
        return mesh
