"""Grasps of the objects of a folder, searched once and kept beside them."""

from __future__ import annotations

import contextlib
import hashlib
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from pwm_gym.assets.folder import DENSITY, AssetFolder
from pwm_gym.errors import PwmGymError
from pwm_gym.files import load_arrays, save_arrays
from pwm_gym.skills.object_grasps import Grasp, ObjectGrasps, find_grasps

__all__ = ["object_grasps"]

_FORMAT = "pwm_gym grasps 1"


def object_grasps(folder: AssetFolder, name: str) -> ObjectGrasps:
    """Ranked grasps of an object: from ``models/<name>/grasps.npz``, or searched (some seconds) and written there.

    What was written for other convex pieces is searched anew; a folder that cannot be written to is left as it is.

    Raises:
        PwmGymError: the object has no readable pieces.
    """
    collision = folder.model(name) / "collision.ply"
    if not collision.is_file():
        raise PwmGymError(f"{collision} does not exist; expected convex pieces of {name!r}")
    return _find(folder, name, hashlib.sha256(collision.read_bytes()).hexdigest())


@dataclass(frozen=True)
class _Header:
    """What a file of grasps says beside its arrays."""

    format: str
    pieces: str


@lru_cache(maxsize=256)
def _find(folder: AssetFolder, name: str, digest: str) -> ObjectGrasps:
    path = folder.model(name) / "grasps.npz"
    with contextlib.suppress(PwmGymError):
        return _read(path, digest)
    known = find_grasps(folder.pieces(name), density=DENSITY)
    rows = np.array([np.hstack(astuple(grasp)) for grasp in known.grasps]).reshape(-1, 12)
    arrays = {"grasps": rows, "cloud": known.cloud, "mass": np.array(known.mass)}
    with contextlib.suppress(OSError):
        save_arrays(path, arrays, {"format": _FORMAT, "pieces": digest})
    return known


def _read(path: Path, digest: str) -> ObjectGrasps:
    arrays, header = load_arrays(path, "holds no grasps", PwmGymError, _FORMAT, _Header)
    if header.pieces != digest:
        raise PwmGymError(f"{path} holds grasps of other pieces")
    return ObjectGrasps(tuple(map(_grasp, arrays["grasps"].tolist())), arrays["cloud"], float(arrays["mass"]))


def _grasp(row: list[float]) -> Grasp:
    position, closing, approach = (tuple(row[i : i + 3]) for i in (0, 3, 6))
    opening, width, score = row[9:]
    return Grasp(position, closing, approach, opening, width, score)  # type: ignore[arg-type]
