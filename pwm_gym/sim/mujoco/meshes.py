"""Surfaces of MuJoCo's geoms."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from pwm_gym.errors import SceneError
from pwm_gym.scene.poses import compose
from pwm_gym.scene.se3 import matrix_from_pose7

if TYPE_CHECKING:
    import trimesh

__all__ = ["body_mesh", "collides", "welded"]

_AT_ORIGIN = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def welded(model: Any, body: int, others: Collection[int] = ()) -> Iterator[tuple[int, np.ndarray]]:
    """A body and all that is fixed to it, each with its pose (7,) in the body's frame.

    Args:
        model: MuJoCo's.
        body: its number.
        others: bodies that are entities of their own, and end the search as joints do.
    """
    yield body, _AT_ORIGIN
    for child in np.flatnonzero(model.body_parentid == body):
        apart = child == 0 or child in others or model.body_jntnum[child] or model.body_mocapid[child] >= 0
        if apart:
            continue
        place = np.r_[model.body_pos[child], model.body_quat[child]]
        for number, pose in welded(model, int(child), others):
            yield number, compose(place, pose)


def body_mesh(model: Any, body: int, others: Collection[int] = (), visual: bool = False) -> trimesh.Trimesh:
    """Outer surface of a body's geoms, and of those fixed to it, in the body's frame, metres.

    Planes are left out. Meshes that collide are their convex hulls, as MuJoCo takes them.

    Args:
        model: MuJoCo's.
        body: its number.
        others: bodies that are entities of their own.
        visual: whether geoms count that collide with nothing, instead of those that collide.

    Raises:
        SceneError: there is no such geom, or one without a surface.
    """
    import trimesh

    parts = []
    for number, place in welded(model, body, others):
        for geom in np.flatnonzero(model.geom_bodyid == number).tolist():
            if collides(model, geom) != visual and model.geom_type[geom] != _kind("PLANE"):
                mesh = _geom_mesh(model, geom, hull=not visual)
                pose = compose(place, np.r_[model.geom_pos[geom], model.geom_quat[geom]])
                mesh.apply_transform(matrix_from_pose7(torch.as_tensor(pose)).numpy())
                parts.append(mesh)
    if not parts:
        what = "visual geom" if visual else "geom that collides"
        raise SceneError(f"body {model.body(body).name!r} has no {what}, planes apart, to sample points from")
    if len(parts) > 1 and all(part.is_volume for part in parts):
        return trimesh.boolean.union(parts, engine="manifold")
    return trimesh.util.concatenate(parts)


def collides(model: Any, geom: int) -> bool:
    """Whether a geom can be touched."""
    paired = geom in model.pair_geom1 or geom in model.pair_geom2
    return bool(paired or model.geom_contype[geom] or model.geom_conaffinity[geom])


def _kind(name: str) -> int:
    import mujoco

    return int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))


def _geom_mesh(model: Any, geom: int, hull: bool) -> trimesh.Trimesh:
    """Surface of one geom in its own frame; MuJoCo's cylinders and capsules lie along z."""
    from trimesh import creation

    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == _kind("MESH"):
        return _stored_mesh(model, int(model.geom_dataid[geom]), hull)
    if kind == _kind("BOX"):
        return creation.box(2 * size)
    if kind == _kind("SPHERE"):
        return creation.icosphere(3, size[0])
    if kind == _kind("ELLIPSOID"):
        mesh = creation.icosphere(3, 1.0)
        mesh.apply_scale(size)
        return mesh
    if kind == _kind("CYLINDER"):
        return creation.cylinder(size[0], 2 * size[1])
    if kind == _kind("CAPSULE"):
        mesh = creation.capsule(2 * size[1], size[0])
        mesh.apply_translation(-mesh.bounds.mean(0))
        return mesh
    name = model.geom(geom).name or f"number {geom}"
    owner = model.body(int(model.geom_bodyid[geom])).name
    told = {_kind("HFIELD"): "a height field", _kind("SDF"): "a signed distance field"}.get(kind, f"of type {kind}")
    raise SceneError(
        f"geom {name!r} of body {owner!r} is {told}; expected a mesh, box, sphere, ellipsoid, cylinder or capsule"
    )


def _stored_mesh(model: Any, number: int, hull: bool) -> trimesh.Trimesh:
    import trimesh

    first, count = model.mesh_vertadr[number], model.mesh_vertnum[number]
    face, faces = model.mesh_faceadr[number], model.mesh_facenum[number]
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    mesh = trimesh.Trimesh(vertices, model.mesh_face[face : face + faces].copy())
    return mesh.convex_hull if hull else mesh
