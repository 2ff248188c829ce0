"""Synthetic views of single objects: what completion is trained and measured on (paper, appendix "Data Generation")."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from pwm_gym.cameras import DepthCamera, RayCaster
from pwm_gym.cameras.occlusion import occlude
from pwm_gym.cameras.sensor import get_sensor
from pwm_gym.completion.draws import log_uniform
from pwm_gym.completion.frame import LEAST, ViewerFrame
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Layout, spread

if TYPE_CHECKING:
    import trimesh

__all__ = ["Batch", "ObjectView", "ViewConfig", "Views"]

_LAYOUT = Layout.build([("object", 1)])
_ATTEMPTS = 100
_SURFACE = 8192  # points of each object's surface that targets are drawn from


@dataclass(frozen=True)
class ViewConfig:
    """How objects are seen. Lengths in metres; an object's size is its longest side."""

    sizes: tuple[float, float] = (0.04, 0.3)
    """Smallest and largest object."""
    distances: tuple[float, float] = (0.4, 1.3)
    """Of the camera from the object's centre; at least one and a half of its size."""
    focal: tuple[float, float] = (130.0, 640.0)
    """Focal lengths in pixels."""
    pixels: tuple[int, int] = (10, 72)
    """Fewest and most pixels across the object; what is seen larger is seen with fewer rays."""
    occluded: float = 0.4
    """Share of the views in which something hides a part of the object."""
    hidden: tuple[float, float] = (0.05, 0.5)
    """Share of the visible pixels that it hides."""
    sensor: str = "d455"
    """Registered sensor model."""
    sensed: float = 0.4
    """Share of the views that it takes."""
    jitter: float = 0.3
    """Share of the views with jittered points (paper's table)."""
    jitter_mean: float = 0.01
    """Mean length of the jitter, in units of the object's size (paper's table, whose units it leaves open)."""
    jitter_spread: float = 0.03
    """Its spread: the paper's "variance", read as a standard deviation (of 0.17 as a variance, no shape were left)."""
    jitter_most: float = 0.05
    """Longest jitter."""

    def clean(self) -> ViewConfig:
        """The same views without occlusion, sensor or jitter."""
        return replace(self, occluded=0.0, sensed=0.0, jitter=0.0)


@dataclass(frozen=True, eq=False)
class ObjectView:
    """One object as a camera at the origin sees it, which looks along z."""

    partial: np.ndarray
    """Points (m, 3) that it sees, float32, in units of the object's size."""
    pose: np.ndarray
    """The object's pose (4, 4), in the same units."""


@dataclass(frozen=True)
class Batch:
    """Views in the viewer's frame."""

    partial: Tensor
    """(B, n, 3), in the order of farthest-point sampling."""
    target: Tensor
    """Points (B, m, 3) of the whole surface."""
    steps: int | None = None
    """Steps of the decoder that they train; None trains all."""

    def to(self, device: str) -> Batch:
        """The same views on ``device``."""
        return replace(self, partial=self.partial.to(device), target=self.target.to(device))


class Views:
    """Random views of objects; each is a pure function of its generator.

    Args:
        meshes: objects, centred, with longest side 1.
        config: how they are seen.
        weights: how often each is drawn, relative to the others; None draws all alike.
        cleaner: makes points (m, 3) of a sensed depth image in metres, a mask and a camera; None back-projects them.

    Raises:
        PwmGymError: there is no mesh, or not one weight for each.
    """

    def __init__(
        self,
        meshes: Sequence[trimesh.Trimesh],
        config: ViewConfig | None = None,
        weights: Sequence[float] | None = None,
        cleaner: Callable[[np.ndarray, np.ndarray, DepthCamera], np.ndarray] | None = None,
    ) -> None:
        if not meshes:
            raise PwmGymError("no meshes to view; expected at least one")
        if weights is not None and len(weights) != len(meshes):
            raise PwmGymError(f"{len(weights)} weights of {len(meshes)} meshes; expected one each")
        self.meshes, self.config, self._cleaner = list(meshes), config or ViewConfig(), cleaner
        chances = np.ones(len(meshes)) if weights is None else np.asarray(weights, np.float64)
        self._chances = chances / chances.sum()
        self._casters: dict[int, RayCaster] = {}
        self._surfaces: dict[int, np.ndarray] = {}

    def surface(self, index: int) -> np.ndarray:
        """Points (8192, 3) all over an object, float32, in its own frame."""
        if index not in self._surfaces:
            import trimesh

            points, _ = trimesh.sample.sample_surface(self.meshes[index], _SURFACE, seed=index)
            self._surfaces[index] = points.astype(np.float32)
        return self._surfaces[index]

    def view(self, index: int, rng: np.random.Generator) -> ObjectView:
        """A view of one object; views that show fewer than 32 points are drawn again.

        Raises:
            PwmGymError: a hundred views in a row do.
        """
        if index not in self._casters:
            self._casters[index] = RayCaster({"object": self.meshes[index]}, _LAYOUT, table=False)
        for _ in range(_ATTEMPTS):
            view = self._attempt(self._casters[index], rng)
            if len(view.partial) >= LEAST:
                return view
        raise PwmGymError(f"mesh {index} shows fewer than {LEAST} points in {_ATTEMPTS} views; expected a thicker one")

    def _attempt(self, caster: RayCaster, rng: np.random.Generator) -> ObjectView:
        c = self.config
        size = log_uniform(rng, *c.sizes)
        distance = max(rng.uniform(*c.distances) / size, 1.5)  # in units of the size
        across = np.clip(log_uniform(rng, *c.focal) / distance, *c.pixels)
        camera = _camera(across * distance, distance)
        pose = np.eye(4)
        pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
        pose[:3, 3] = 0.0, 0.0, distance
        depth = caster.view(camera, pose[None]).depth
        mask = depth > 0
        if mask.any() and rng.random() < c.occluded:
            mask = occlude(mask, rng.uniform(*c.hidden), rng)
        if rng.random() < c.sensed:
            points = self._sensed(depth * size, mask, camera, rng) / size
        else:
            points = camera.back_project(depth)[mask]
        if rng.random() < c.jitter:
            points = points + self._jitter(points.shape, rng)
        return ObjectView(points.astype(np.float32), pose)

    def _sensed(self, depth: np.ndarray, mask: np.ndarray, camera: DepthCamera, rng: np.random.Generator) -> np.ndarray:
        """Points (m, 3) in metres that the sensor sees of a depth image (H, W) in metres."""
        depth = get_sensor(self.config.sensor).apply(depth, camera, rng)
        if self._cleaner is None:
            return camera.back_project(depth)[mask & (depth > 0)]
        try:
            return self._cleaner(depth, mask, camera)
        except PwmGymError:  # too little is left: such a view is drawn again
            return np.empty((0, 3))

    def _jitter(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        c = self.config
        direction = rng.standard_normal(shape)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        length = rng.normal(c.jitter_mean, c.jitter_spread, (*shape[:-1], 1))
        return direction * np.clip(length, -c.jitter_most, c.jitter_most)

    def batch(self, rng: np.random.Generator, count: int, points: int, target: int) -> Batch:
        """``count`` views of random objects: ``points`` that are seen of each, and ``target`` of its surface."""
        partials, targets = [], []
        for index in rng.choice(len(self.meshes), size=count, p=self._chances):
            view = self.view(int(index), rng)
            seen = spread(view.partial, points, rng)
            frame = ViewerFrame.of(seen, np.zeros(3))
            chosen = self.surface(int(index))[rng.choice(_SURFACE, target, replace=False)]
            partials.append(frame.enter(seen))
            targets.append(frame.enter(chosen @ view.pose[:3, :3].T + view.pose[:3, 3]))
        return Batch(torch.from_numpy(np.stack(partials)), torch.from_numpy(np.stack(targets)))


def _camera(focal: float, distance: float) -> DepthCamera:
    """Camera at the origin whose image holds a sphere of the object's longest diagonal, ``distance`` away."""
    radius = 0.5 * 3.0**0.5
    half = int(np.ceil(focal * radius / np.sqrt(distance**2 - radius**2)))
    middle = half - 0.5
    intrinsics = np.array([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    return DepthCamera(intrinsics, np.eye(4), 2 * half, 2 * half)
