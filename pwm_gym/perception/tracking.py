"""Rigid tracking: where known clouds are in later views, which show only parts of them.

A cloud is completed once per entity; afterwards each view's points are registered to it (iterative closest points,
partial to complete: every seen point has a place on the whole, but not the other way round). The last pose is the
guess of the next one. That keeps an entity's identity, and a symmetric one's too: a cube fits in 24 ways, of which the
nearest to the guess is found as long as it turns by clearly less than 45 degrees between two views.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from pwm_gym.cameras.camera import check_pose
from pwm_gym.errors import PwmGymError, look_up

__all__ = [
    "Registration",
    "Surface",
    "Tracker",
    "TrackingConfig",
    "body_motion",
    "least_motion",
    "register",
    "seen_part",
    "surface_weights",
    "thinned",
    "turned_back",
]

_NEIGHBOURS = 9  # points that span a normal: fewer are noisy, more round off edges
_SLIDE = 0.05  # weight of distances along the surface: edges hold what planes let slide (0.02 to 0.15 do equally well)
_TRIM = 3.0  # times the median distance is the gate: a neighbour's points among the farther half do not widen it
_DAMPING = 1e-9  # square metres; a ball's rotation stays as it is
_SETTLED = 1e-4  # radians and metres: a smaller step is the last
_FLIP = 100.0  # radius of the sphere on which hidden points are told, in units of the farthest one's distance
_TURNS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(1, 2, 0).reshape(3, 9)  # p -> (3, 3), columns axis x p
_TIE = 0.1  # share of inliers by which two registrations are equally good
_FEWEST = 8  # points of a cloud or view that determine a pose at all


@dataclass(frozen=True, eq=False)
class Registration:
    """How a view fits a canonical cloud."""

    pose: np.ndarray
    """(4, 4): canonical coordinates to the view's frame."""
    rms: float
    """Root mean square distance in metres of the inliers to the cloud's surface; infinite without inliers."""
    inliers: float
    """Share of the view's points that lie on the cloud, 0 to 1."""


@dataclass(frozen=True)
class TrackingConfig:
    """When a view is believed, and how it is registered."""

    gate: float = 0.008
    """Distance in metres up to which a point lies on the surface: four times the depth's noise."""
    reach: float = 0.06
    """Distance in metres from which points still pull at first; less where the guess is good."""
    iterations: int = 20
    """Most steps of a registration."""
    min_points: int = 32
    """A view with fewer points is none."""
    max_points: int = 500
    """A view with more points is thinned, for the time's sake."""
    max_rms: float = 0.005
    """Largest root mean square distance, metres."""
    min_inliers: float = 0.6
    """Smallest share of points that must lie on the cloud."""


class Tracker:
    """Follows entities through views; those that are not seen (well) keep their last pose, or go with their carrier.

    All poses and points are in one frame, the robot base's; lengths are metres.

    Args:
        clouds: entity name -> complete canonical points (n, 3).
        poses: entity name -> where it is at first (4, 4).
        config: thresholds.

    Raises:
        PwmGymError: a cloud or pose has a wrong shape or is not finite, or an entity lacks its pose.
    """

    registrations: dict[str, Registration]
    """The entities that were found in the last update, and how well."""

    def __init__(
        self,
        clouds: Mapping[str, np.ndarray],
        poses: Mapping[str, np.ndarray],
        config: TrackingConfig | None = None,
    ) -> None:
        self.config = config or TrackingConfig()
        self.registrations = {}
        self._clouds: dict[str, np.ndarray] = {}
        self._surfaces: dict[str, Surface] = {}
        self._history: dict[str, np.ndarray] = {}
        for name, cloud in clouds.items():
            self.track(name, cloud, look_up("pose", name, poses))

    def track(self, name: str, cloud: np.ndarray, pose: np.ndarray) -> None:
        """Follow an entity from ``pose`` (4, 4) on; a known one gets a new ``cloud`` (n, 3) and is at rest."""
        points = _checked_points(f"the cloud of {name!r}", cloud)
        surface = Surface.of(points)
        start = check_pose(f"the pose of {name!r}", pose)
        self._clouds[name], self._surfaces[name], self._history[name] = points, surface, np.repeat(start[None], 3, 0)

    @property
    def poses(self) -> dict[str, np.ndarray]:
        """Entity name -> its present pose (4, 4)."""
        return {name: history[0].copy() for name, history in self._history.items()}

    def history(self, name: str) -> np.ndarray:
        """Poses (3, 4, 4) of an entity after the last update, the one before and the one before that."""
        return look_up("entity", name, self._history).copy()

    def points(self) -> dict[str, np.ndarray]:
        """Entity name -> its complete cloud (n, 3) where it is now, seen or not."""
        poses = self.poses
        return {n: cloud @ poses[n][:3, :3].T + poses[n][:3, 3] for n, cloud in self._clouds.items()}

    def update(
        self,
        partials: Mapping[str, np.ndarray],
        *,
        eye: np.ndarray | None = None,
        carried_by: Mapping[str, str] | None = None,
        motion: Mapping[str, np.ndarray] | None = None,
    ) -> dict[str, np.ndarray]:
        """Take in a view.

        Args:
            partials: entity name -> the points (m, 3) that are seen of it; entities may be missing.
            eye: where the one camera stood (3,). With it points are matched only with surface that it could see, which
                keeps apart the two sides of thin things and finds entities again after larger motions.
            carried_by: entity name -> carrier, of the entities that are grasped.
            motion: carrier -> its motion (4, 4) since the last update, ``now @ inverse(before)``. What it carries is
                expected there, and is taken to be there while it is not seen.

        Returns:
            Entity name -> pose (4, 4), of all entities.

        Raises:
            PwmGymError: an unknown entity, a carrier without motion, or points of a wrong shape or not finite.
        """
        for name in partials:
            look_up("entity", name, self._surfaces)
        guesses = self._expect(carried_by or {}, motion or {})
        found = {n: self._find(n, partials[n], guesses[n], eye) for n in partials}
        self.registrations = {name: fit for name, fit in found.items() if fit is not None}
        for name, guess in guesses.items():
            pose = self.registrations[name].pose if name in self.registrations else guess
            self._history[name] = np.concatenate([pose[None], self._history[name][:2]])
        return self.poses

    def _expect(self, carried_by: Mapping[str, str], motion: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Where entities are if they rest, or move as their carriers do."""
        guesses = self.poses
        for name, carrier in carried_by.items():
            step = check_pose(f"the motion of {carrier!r}", look_up("motion", carrier, motion))
            guesses[name] = step @ look_up("entity", name, guesses)
        return guesses

    def _find(self, name: str, partial: np.ndarray, guess: np.ndarray, eye: np.ndarray | None) -> Registration | None:
        """Registration of a view from the guess; if it is poor or the entity was lost, from the points' place too."""
        config, surface = self.config, self._surfaces[name]
        if len(partial) < config.min_points:
            return None
        points = thinned(_checked_points(f"the view of {name!r}", partial), config.max_points)
        seen = surface.seen_from(guess, eye)
        fits = [_fit(surface, seen, points, guess, config)]
        if name not in self.registrations or not self._good(fits[0]):
            fits.append(_fit(surface, seen, points, seen.moved_onto(points, guess), config))
        return self._best([fit for fit in fits if self._good(fit)], guess)

    def _good(self, fit: Registration) -> bool:
        return fit.rms <= self.config.max_rms and fit.inliers >= self.config.min_inliers

    def _best(self, fits: list[Registration], guess: np.ndarray) -> Registration | None:
        """The best of registrations; of nearly equal ones that which turns least, as symmetric entities fit often."""
        quality = [fit.inliers - fit.rms / self.config.gate for fit in fits]
        equal = [fit for fit, value in zip(fits, quality, strict=True) if value > max(quality) - _TIE]
        return max(equal, key=lambda fit: np.sum(fit.pose[:3, :3] * guess[:3, :3]), default=None)


def register(
    canonical: np.ndarray,
    partial: np.ndarray,
    guess: np.ndarray,
    *,
    eye: np.ndarray | None = None,
    config: TrackingConfig | None = None,
) -> Registration:
    """Pose at which a complete cloud explains a partial view of it.

    Each seen point is drawn to the plane of its nearest canonical point. Points farther than a few times the median
    distance do not count, so that a fifth of them may belong to a neighbour.

    Args:
        canonical: complete cloud (n, 3) in its own frame, metres.
        partial: points (m, 3) seen by a camera.
        guess: pose (4, 4) near the one sought: within about a third of the entity's size, and 20 degrees.
        eye: where the camera stood (3,), if known; see :meth:`Tracker.update`.
        config: distances and iterations; its thresholds are left to the caller.

    Raises:
        PwmGymError: an array of a wrong shape, with too few points or not finite.
    """
    surface = Surface.of(_checked_points("the canonical cloud", canonical))
    points, start = _checked_points("the view", partial), check_pose("the guess", guess)
    return _fit(surface, surface.seen_from(start, eye), points, start, config or TrackingConfig())


def thinned(points: np.ndarray, most: int) -> np.ndarray:
    """At most ``most`` of points (m, 3), evenly chosen."""
    return points[:: -(-len(points) // most)]


def seen_part(points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Those of points (n, 3) that an eye (3,) sees: the hull of the points flipped about it.

    Katz, Tal and Basri, "Direct visibility of point sets", 2007.
    """
    return np.asarray(points[_seen_from(points, eye)])


def _seen_from(points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Places of the points that are seen."""
    rays = points - eye
    distances = np.linalg.norm(rays, axis=1, keepdims=True).clip(1e-9)
    flipped = rays * (2 * _FLIP * distances.max() / distances - 1)
    hull = ConvexHull(np.concatenate([flipped, np.zeros((1, 3))]), qhull_options="QJ").vertices
    return np.asarray(hull[hull < len(points)])


class Surface(NamedTuple):
    """A canonical cloud with what registrations ask of it."""

    points: np.ndarray
    normals: np.ndarray  # (n, 3), of either sign
    spacing: float  # metres between neighbours
    tree: Any

    @classmethod
    def of(cls, points: np.ndarray) -> Surface:
        """Surface of a cloud (n, 3), with normals from each point's neighbours; repeated points count once."""
        points = np.unique(points, axis=0)
        if len(points) < _FEWEST:
            raise PwmGymError(f"a cloud has {len(points)} different points; expected at least {_FEWEST}")
        tree = cKDTree(points)
        distances, index = tree.query(points, min(_NEIGHBOURS, len(points)))
        around = points[index] - points[index].mean(1, keepdims=True)  # (n, k, 3)
        _, axes = np.linalg.eigh(around.transpose(0, 2, 1) @ around)
        return cls(points, axes[:, :, 0], float(np.median(distances[:, 1])), tree)

    def seen_from(self, pose: np.ndarray, eye: np.ndarray | None) -> Surface:
        """The part that an eye (3,) sees of the cloud at ``pose``."""
        if eye is None:
            return self
        place = np.asarray(eye, np.float64)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise PwmGymError(f"the eye is at {eye!r}; expected 3 numbers")
        seen = _seen_from(self.points, (place - pose[:3, 3]) @ pose[:3, :3])
        return Surface(self.points[seen], self.normals[seen], self.spacing, cKDTree(self.points[seen]))

    def moved_onto(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """``pose`` (4, 4), shifted so that the cloud is in the midst of ``points`` (m, 3)."""
        moved = pose.copy()
        moved[:3, 3] = np.median(points, 0) - pose[:3, :3] @ np.median(self.points, 0)
        return moved

    def match(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (m,) of canonical points (m, 3) to the nearest one's, the way there (m, 3) and its normal (m, 3)."""
        distances, index = self.tree.query(points)
        return distances, self.points[index] - points, self.normals[index]


def _fit(
    surface: Surface, seen: Surface, points: np.ndarray, guess: np.ndarray, config: TrackingConfig
) -> Registration:
    """Registration of checked points (m, 3): to the part of a surface that is ``seen``, then to all of it."""
    pose = guess
    for part in (surface,) if seen is surface else (seen, surface):
        pose = _approach(part, points, pose, config)
    return _judge(surface, points, pose, config.gate)


def _approach(surface: Surface, points: np.ndarray, guess: np.ndarray, config: TrackingConfig) -> np.ndarray:
    """Pose (4, 4) of a surface after Gauss-Newton steps, each with its own nearest points."""
    pose = guess.copy()
    for _ in range(config.iterations):
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        distances, way, normals = surface.match(local)
        scale = min(max(_TRIM * float(np.median(distances)), config.gate), config.reach)
        step = _step(local, way, normals, surface_weights(distances, way, normals, scale, surface.spacing))
        pose[:3, :3] = turned_back(pose[:3, :3], step[:3])
        pose[:3, 3] -= pose[:3, :3] @ step[3:]
        if np.abs(step).max() < _SETTLED:
            break
    return pose


def surface_weights(
    distances: np.ndarray, way: np.ndarray, normals: np.ndarray, scale: float, spacing: float
) -> np.ndarray:
    """Tukey's weights (m,) of distances to the surface; 0 where no canonical point is near."""
    near = distances < scale + 1.5 * spacing
    return np.where(near, (1 - ((way * normals).sum(1) / scale) ** 2).clip(0) ** 2, 0.0)


def _step(points: np.ndarray, way: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Small motion (6,), rotation vector and translation, that takes points (m, 3) their ``way`` to the surface."""
    return least_motion(body_motion(points), way, normals, weights)


def body_motion(points: np.ndarray) -> np.ndarray:
    """What the components of a small rotation vector and translation do to points (m, 3): (m, 3, 6)."""
    motion = np.empty((len(points), 3, 6))
    motion[:, :, :3] = (points @ _TURNS).reshape(-1, 3, 3)
    motion[:, :, 3:] = np.eye(3)
    return motion


def least_motion(motion: np.ndarray, way: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Components (k,) of a small motion that takes points (m, 3) their ``way`` to the surface.

    Gauss-Newton: least squares of what is left along the normals and, weakly, along the surface.

    Args:
        motion: what the components do to the points (m, 3, k).
        way: to the nearest points of the surface (m, 3).
        normals: of the surface there (m, 3).
        weights: (m,).
    """
    metric = normals[:, :, None] * normals[:, None, :] + _SLIDE * np.eye(3)
    weighted = (weights[:, None, None] * metric @ motion).reshape(len(way) * 3, -1)
    gram = weighted.T @ motion.reshape(len(way) * 3, -1) + _DAMPING * np.eye(motion.shape[-1])
    return np.asarray(np.linalg.solve(gram, weighted.T @ way.ravel()))


def turned_back(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """``rotation`` (3, 3) after the inverse of a small one, given by its vector (3,); Cayley's form of it."""
    half = 0.5 * (vector @ _TURNS).reshape(3, 3)
    return rotation @ np.linalg.solve(np.eye(3) - half, np.eye(3) + half)


def _judge(surface: Surface, points: np.ndarray, pose: np.ndarray, gate: float) -> Registration:
    """How well a pose explains points (m, 3)."""
    distances, way, normals = surface.match((points - pose[:3, 3]) @ pose[:3, :3])
    gaps = np.abs((way * normals).sum(1))
    on = (distances < gate + 1.5 * surface.spacing) & (gaps < gate)
    rms = float(np.sqrt(np.square(gaps[on]).mean())) if on.any() else float("inf")
    return Registration(pose, rms, float(on.mean()))


def _checked_points(name: str, points: np.ndarray) -> np.ndarray:
    array = np.asarray(points, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) < _FEWEST:
        raise PwmGymError(f"{name} has shape {array.shape}; expected ({_FEWEST} or more, 3)")
    if not np.isfinite(array).all():
        raise PwmGymError(f"{name} holds {int((~np.isfinite(array)).sum())} values that are not finite")
    return array
