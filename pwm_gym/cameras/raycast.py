"""A depth and segmentation camera by ray casting (Embree): the same for every simulator, without a GPU.

Each entity has one bounding volume hierarchy in its own frame, built once; rays are moved into that frame. Ray
directions are not normalised, so that hit distances are depths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from pwm_gym.cameras.camera import DepthCamera
from pwm_gym.errors import SceneError
from pwm_gym.scene import Layout

if TYPE_CHECKING:
    import trimesh

__all__ = ["RayCaster", "View"]

_SLACK = 2e-3  # metres: a point this close behind the first hit is still on that surface


@dataclass(frozen=True, eq=False)
class View:
    """What a camera sees."""

    depth: np.ndarray
    """(H, W) float32, metres along the line of sight; 0 where there is nothing."""
    segmentation: np.ndarray
    """(H, W) int16: index of the entity, -1 for the table, -2 for nothing."""


class RayCaster:
    """Casts rays at the entities of a scene and at the table (the plane z = 0).

    Args:
        meshes: each entity's surface in its own frame, metres.
        layout: the entities.
        table: whether the plane z = 0 is there.

    Raises:
        SceneError: an entity has no mesh.
    """

    def __init__(self, meshes: Mapping[str, trimesh.Trimesh], layout: Layout, table: bool = True) -> None:
        missing = [name for name in layout.names if name not in meshes]
        if missing:
            raise SceneError(f"no mesh for {', '.join(missing)}; got {', '.join(meshes) or 'none'}")
        self.layout, self.table = layout, table
        self._scenes = [_hierarchy(meshes[name]) for name in layout.names]

    def view(self, camera: DepthCamera, poses: np.ndarray) -> View:
        """Depth and segmentation of entities at ``poses`` (E, 4, 4)."""
        rays = camera.rays().reshape(-1, 3)
        depth, entity = self._first(camera.pose[:3, 3], rays, poses)
        shape = (camera.height, camera.width)
        nothing = ~np.isfinite(depth)
        return View(
            np.where(nothing, 0.0, depth).astype(np.float32).reshape(shape),
            np.where(nothing, -2, entity).astype(np.int16).reshape(shape),
        )

    def visible(self, camera: DepthCamera, points: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """Bool (M,): which points (M, 3) on surfaces the camera sees, inside its image and before all else.

        Args:
            camera: looks.
            points: in the base's frame.
            poses: of the entities (E, 4, 4).
        """
        u, v, distance = camera.project(points).T
        inside = (distance > 0) & (u >= -0.5) & (v >= -0.5) & (u < camera.width - 0.5) & (v < camera.height - 0.5)
        origin = camera.pose[:3, 3]
        rays = points - origin
        nearest, _ = self._first(origin, rays, poses)
        reach = np.linalg.norm(rays, axis=1)
        return inside & ((1.0 - nearest) * reach < _SLACK)

    def _first(self, origin: np.ndarray, rays: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance (M,) of the first hit in units of each ray (M, 3), infinite without one, and its entity (M,)."""
        nearest = np.full(len(rays), np.inf)
        entity = np.full(len(rays), -2)
        if self.table:
            with np.errstate(divide="ignore"):
                ground = np.where(rays[:, 2] * origin[2] < 0, -origin[2] / rays[:, 2], np.inf)
            nearest, entity = ground, np.where(np.isfinite(ground), -1, entity)
        for index, (scene, pose) in enumerate(zip(self._scenes, poses, strict=True)):
            rotation = pose[:3, :3]
            local = np.ascontiguousarray(rays @ rotation, np.float32)
            start = np.broadcast_to((origin - pose[:3, 3]) @ rotation, local.shape)
            distance = scene.run(np.ascontiguousarray(start, np.float32), local, query="DISTANCE")
            distance = np.where(distance < 1e30, distance, np.inf)
            closer = distance < nearest
            nearest, entity = np.where(closer, distance, nearest), np.where(closer, index, entity)
        return nearest, entity


def _hierarchy(mesh: trimesh.Trimesh) -> Any:
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene(_device())
    TriangleMesh(scene, np.ascontiguousarray(mesh.triangles, np.float32))
    return scene


@cache
def _device() -> Any:
    """The one device of this process: with one for each hierarchy, Embree crashes at a thousand of them."""
    from embreex import rtcore

    return rtcore.EmbreeDevice()
