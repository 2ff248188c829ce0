"""Surfaces of SAPIEN's collision shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from pwm_gym.errors import SceneError

__all__ = ["collision_mesh"]


def collision_mesh(entity: Any, united: bool = False) -> trimesh.Trimesh:
    """Surface of an entity's collision shapes in its own frame, metres.

    Args:
        entity: SAPIEN's.
        united: whether of boxes and cylinders that overlap the outer surface alone is left. The robot's links, of which
            stored clouds exist, keep all faces; so do convex pieces of a mesh, which only touch each other.

    Raises:
        SceneError: it has none, or one without a surface (a plane).
    """
    from sapien.physx import PhysxRigidBaseComponent

    primitives: list[trimesh.Trimesh] = []
    pieces: list[trimesh.Trimesh] = []
    for component in entity.components:
        if isinstance(component, PhysxRigidBaseComponent):
            for shape in component.collision_shapes:
                mesh = _shape_mesh(shape)
                mesh.apply_transform(shape.local_pose.to_transformation_matrix())
                (pieces if hasattr(shape, "vertices") else primitives).append(mesh)
    if not primitives and not pieces:
        raise SceneError(f"{entity.name!r} has no collision shape to sample points from")
    if united and len(primitives) > 1:
        primitives = [trimesh.boolean.union(primitives, engine="manifold")]
    return trimesh.util.concatenate([*primitives, *pieces])


def _shape_mesh(shape: Any) -> trimesh.Trimesh:
    """Surface of one collision shape; SAPIEN's cylinders and capsules lie along x."""
    kind = type(shape).__name__
    if hasattr(shape, "vertices"):
        return trimesh.Trimesh(shape.vertices * shape.scale, shape.triangles)
    if hasattr(shape, "half_size"):
        return trimesh.creation.box(2 * np.asarray(shape.half_size))
    if kind == "PhysxCollisionShapeSphere":
        return trimesh.creation.icosphere(3, shape.radius)
    if kind == "PhysxCollisionShapeCylinder":
        mesh = trimesh.creation.cylinder(shape.radius, 2 * shape.half_length)
    elif kind == "PhysxCollisionShapeCapsule":
        mesh = trimesh.creation.capsule(2 * shape.half_length, shape.radius)
        mesh.apply_translation(-mesh.bounds.mean(0))
    else:
        raise SceneError(f"collision shape {kind} has no surface to sample points from")
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    return mesh
