"""Reading meshes for fine-tuning and use: folders, single files and archives; and bringing them to one size."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from pwm_gym.errors import PwmGymError, unknown_name
from pwm_gym.files import load_arrays

__all__ = ["load_meshes", "normalise"]

_SUFFIXES = (".glb", ".obj", ".ply", ".stl")
_EXPECTED = f"a mesh file ({', '.join(_SUFFIXES)}), a folder of these, or an .npz of <object>/v and <object>/f"


def normalise(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy of ``mesh`` with its bounding box centred at the origin and the longest side 1.

    Raises:
        PwmGymError: the mesh has no faces, no extent, or vertices that are not finite.
    """
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all() or not mesh.extents.max() > 0:
        raise PwmGymError(f"cannot normalise {mesh!r}: expected faces, finite vertices and a positive extent")
    vertices = (mesh.vertices - mesh.bounds.mean(0)) / mesh.extents.max()
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def load_meshes(path: str | Path, names: Iterable[str] | None = None) -> dict[str, trimesh.Trimesh]:
    """Meshes by name, in the order of ``names`` or of the alphabet, in their own frames and units.

    A mesh that is not watertight is kept as it is, with a warning: ray casting and surface sampling still work on it,
    but it has no reliable inside or volume. Vertices at one place become one; colours and textures are dropped.

    Args:
        path: a folder of .glb, .obj, .ply and .stl files or one such file, named by their stems; or an .npz archive
            with two arrays an object, ``<object>/v`` (V, 3) vertices and ``<object>/f`` (F, 3) indices of them.
        names: the ones to read; None for all.

    Raises:
        PwmGymError: nothing is there, or what is there is no mesh or not what it should be.
        UnknownNameError: no mesh has one of the ``names``.
    """
    path = Path(path)
    readers = _readers(path)
    if not readers:
        raise PwmGymError(f"{path} holds no meshes; expected {_EXPECTED}")
    wanted = sorted(readers) if names is None else list(names)
    for name in wanted:
        if name not in readers:
            raise unknown_name(f"mesh of {path}", name, readers)
    meshes = {name: readers[name]() for name in wanted}
    open_ones = [name for name, mesh in meshes.items() if not mesh.is_watertight]
    if open_ones:
        text = f"{path}: not watertight, kept as they are ({len(open_ones)} of {len(meshes)}): {', '.join(open_ones)}"
        warnings.warn(text, UserWarning, stacklevel=2)
    return meshes


def _readers(path: Path) -> dict[str, Callable[[], trimesh.Trimesh]]:
    """How to read each mesh of ``path``."""
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES)
    elif not path.is_file():
        raise PwmGymError(f"{path} does not exist; expected {_EXPECTED}")
    elif path.suffix.lower() == ".npz":
        return _archive_readers(path)
    elif path.suffix.lower() not in _SUFFIXES:
        raise PwmGymError(f"{path} has the suffix {path.suffix!r}; expected {_EXPECTED}")
    else:
        files = [path]
    stems = [file.stem for file in files]
    for file in files:
        if stems.count(file.stem) > 1:
            raise PwmGymError(f"{path} holds {stems.count(file.stem)} meshes of the name {file.stem!r}; expected one")
    return {file.stem: partial(_read_file, file) for file in files}


def _read_file(path: Path) -> trimesh.Trimesh:
    try:
        mesh = trimesh.load(path, force="mesh")
        vertices, faces = mesh.vertices, mesh.faces
    except Exception as error:  # each format's reader has its own errors, down to AttributeError
        raise PwmGymError(f"{path} is no readable {path.suffix} mesh ({error}); expected {_EXPECTED}") from error
    return _mesh(vertices, faces, str(path))


def _archive_readers(path: Path) -> dict[str, Callable[[], trimesh.Trimesh]]:
    arrays, _ = load_arrays(path, f"is no readable .npz archive; expected {_EXPECTED}", PwmGymError, gaps=None)
    names = {key.rpartition("/")[0] for key in arrays}
    foreign = sorted(arrays.keys() ^ {f"{name}/{part}" for name in names for part in "vf"})
    if foreign:
        raise PwmGymError(f"{path}: {', '.join(foreign[:4])} missing or foreign; expected {_EXPECTED}")
    return {name: partial(_mesh, arrays[f"{name}/v"], arrays[f"{name}/f"], f"{path}: {name!r}") for name in names}


def _mesh(vertices: np.ndarray, faces: np.ndarray, where: str) -> trimesh.Trimesh:
    """Checked mesh of ``vertices`` and ``faces``; ``where`` they came from is told in errors."""
    vertices, faces = np.asarray(vertices), np.asarray(faces)
    if not vertices.size or not faces.size:
        raise PwmGymError(f"{where} has no faces; expected a triangle mesh")
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or vertices.dtype.kind not in "fiu":
        raise PwmGymError(f"{where}: vertices {vertices.shape}, faces {faces.shape}; expected numbers (V, 3), (F, 3)")
    if faces.dtype.kind not in "iu" or faces.min() < 0 or faces.max() >= len(vertices):
        raise PwmGymError(f"{where}: faces are no indices; expected integers from 0 to {len(vertices) - 1}")
    if not np.isfinite(vertices).all():
        raise PwmGymError(f"{where}: {(~np.isfinite(vertices)).any(1).sum()} vertices are not finite")
    return trimesh.Trimesh(vertices.astype(float), faces.astype(int), process=True)
