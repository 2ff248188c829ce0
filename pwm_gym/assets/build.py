"""Building ManiSkill's folder of YCB objects from meshes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import trimesh
from tqdm import tqdm

from pwm_gym.assets.folder import AssetFolder
from pwm_gym.assets.names import check_ycb_name
from pwm_gym.assets.pieces import PieceConfig, convex_pieces
from pwm_gym.completion.meshes import load_meshes
from pwm_gym.errors import PwmGymError
from pwm_gym.files import write_atomically
from pwm_gym.workers import work_through

__all__ = ["build_ycb"]

_LARGEST = 1.0  # metres; the longest object of YCB has 0.4, and a larger one was given in millimetres
_ATTRIBUTION = """\
The objects in this folder whose names begin with a number are objects of the YCB Object and Model Set:
B. Calli, A. Walsman, A. Singh, S. Srinivasa, P. Abbeel and A. M. Dollar, "Benchmarking in Manipulation Research: The
YCB Object and Model Set and Benchmarking Protocols", IEEE Robotics and Automation Magazine 22(3), 2015.
https://www.ycbbenchmarks.com

Licence: Creative Commons Attribution 4.0 International (CC BY 4.0), https://creativecommons.org/licenses/by/4.0/

Changed against the meshes that were given to `pwm-gym assets ycb`: each was moved so that its bounding box is centred
at the origin (textured.obj); colours and textures were dropped; convex pieces that approximate it were added
(collision.ply). The meshes that were given may have been decimated before.
"""


def build_ycb(
    source: str | Path,
    root: str | Path,
    objects: tuple[str, ...] = (),
    workers: int = 1,
    config: PieceConfig | None = None,
) -> AssetFolder:
    """Build the folder that PickSingleYCB reads; objects that are there already are kept.

    Args:
        source: meshes in metres, named as in YCB: an ``.npz`` of ``<object>/v`` and ``<object>/f``, or a folder of
            .glb, .obj, .ply and .stl files.
        root: folder to build in, as ``MS_ASSET_DIR`` names it.
        objects: names of those to build; none for all of the source.
        workers: number of processes.
        config: how the meshes are cut into convex pieces.

    Raises:
        PwmGymError: the source cannot be read, a mesh in it is empty, not finite, flat or not in metres, or one of
            several processes died.
        UnknownNameError: an object is not in the source, or not one of YCB's.
    """
    folder = AssetFolder(Path(root).expanduser())
    meshes = load_meshes(source, objects or None)
    for name, mesh in meshes.items():
        _check_size(check_ycb_name(name), mesh)
    missing = {name: mesh for name, mesh in meshes.items() if not folder.has(name)}
    write_atomically(folder.base / "ATTRIBUTION.txt", _ATTRIBUTION.encode())
    listed = set(folder.names()) if folder.exists() else set()
    for name in tqdm(_build_all(folder, missing, workers, config), total=len(missing), desc="convex pieces"):
        listed.add(name)
        folder.write_info(sorted(listed))
    folder.write_info(sorted(listed | meshes.keys()))
    return folder


def _check_size(name: str, mesh: trimesh.Trimesh) -> None:
    size = float(mesh.extents.max())
    if not 0 < size <= _LARGEST:
        raise PwmGymError(f"{name} is {size:.3g} long; expected metres, at most {_LARGEST}")


def _build_all(
    folder: AssetFolder, meshes: dict[str, trimesh.Trimesh], workers: int, config: PieceConfig | None
) -> Iterator[str]:
    """Build each object, and give its name when it is done."""
    if workers < 1:
        raise PwmGymError(f"workers is {workers}; expected at least 1")
    if workers > 1:
        os.environ.setdefault("OMP_NUM_THREADS", "1")  # CoACD's threads; the processes are enough
    yield from work_through(partial(_build, folder, config), list(meshes.items()), workers)


def _build(folder: AssetFolder, config: PieceConfig | None, named: tuple[str, trimesh.Trimesh]) -> str:
    name, mesh = named
    centred = trimesh.Trimesh(mesh.vertices - mesh.bounds.mean(0), mesh.faces, process=False)
    try:
        folder.write(name, centred, convex_pieces(centred, config))
    except PwmGymError as error:
        raise PwmGymError(f"{name}: {error}") from error
    return name
