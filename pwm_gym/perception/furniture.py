"""Bodies whose parts hang on each other by joints, such as a cabinet with its drawer: found and followed in views.

They are known by their canonical clouds, as the robot's links are: no view of a shut drawer tells what its inside looks
like. The first view tells where the body stands and how far its joints are open; later ones tell the joints alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.perception.tracking import (
    Surface,
    TrackingConfig,
    body_motion,
    least_motion,
    seen_part,
    surface_weights,
    thinned,
    turned_back,
)
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Joint, Layout

__all__ = ["Furniture", "furniture_names"]

_YAWS, _OPEN = 24, 5  # turns about the vertical, and positions of the joints, that are tried at first
_REFINED = 4  # of these guesses are refined
_ROUNDS, _LOOK_AGAIN = 40, 8  # Gauss-Newton steps of a guess, and after how many what is visible is told anew
_FAR = 0.03  # metres: a point farther from the cloud counts as that far
_REACH = {"prismatic": 0.04, "revolute": 0.35}  # metres and radians that a joint moves between two views, at the most
_STEPS, _FINER = 25, 11  # positions that are tried, and then between the best one's neighbours
_NEWTON = 6  # Gauss-Newton steps of a joint
_TINY = 1e-4  # metres or radians that tell what a joint does to points
_TRIM = 3.0  # times the median distance is the gate of a step
_ABOVE = 0.02  # metres over a part's highest point up to which something is in it
_INSIDE = 0.006  # metres over a part's lowest point at which what is in it stands


def furniture_names(layout: Layout) -> tuple[str, ...]:
    """Entities that the robot does not drive and that hang on a sliding or turning joint, and what they hang on."""
    parts = [e for e in layout if not e.driven and e.joint.moves]
    named = {e.name for e in parts} | {e.joint.parent for e in parts}
    return tuple(e.name for e in layout if e.name in named)


class Furniture:
    """Poses of all parts of the articulated bodies of a scene; frames are the robot base's, lengths metres.

    Args:
        layout: of the scene.
        clouds: entity -> canonical points (n, 3), of :func:`furniture_names`.
        tracking: thresholds of registrations.

    Raises:
        SceneError: a joint hangs on the world, on the robot or on another joint.
    """

    def __init__(
        self, layout: Layout, clouds: Mapping[str, np.ndarray], tracking: TrackingConfig | None = None
    ) -> None:
        self.moving = [layout.names[k] for k in layout.articulated]
        config = tracking or TrackingConfig()
        hung: dict[str, list[str]] = {}
        for name in self.moving:
            parent = layout[name].joint.parent
            if parent is None or layout[parent].driven or parent in self.moving:
                raise SceneError(
                    f"{name!r} hangs on {parent!r}; perception expects a part that hangs on a resting body"
                )
            hung.setdefault(parent, []).append(name)
        self._parts = {n: _Part.of(layout, n, clouds[n], config.max_points) for n in furniture_names(layout)}
        self._drawers = [name for name in self.moving if self._parts[name].joint.kind == "prismatic"]
        self._bodies = [_Body({n: self._parts[n] for n in (root, *parts)}, config) for root, parts in hung.items()]
        self._config = config
        self._history: dict[str, np.ndarray] = {}

    def __contains__(self, name: str) -> bool:
        """Whether an entity is a part of one of the bodies."""
        return name in self._parts

    @property
    def hides(self) -> bool:
        """Whether a part slides, in which an object may be hidden."""
        return bool(self._drawers)

    def history(self, name: str) -> np.ndarray:
        """Poses (3, 4, 4) of a part after the last view, the one before and the one before that."""
        return self._history[name].copy()

    def motion(self, name: str) -> np.ndarray:
        """Motion (4, 4) of a part since the last view, ``now @ inverse(before)``."""
        now, before, _ = self._history[name]
        return np.asarray(now @ np.linalg.inv(before))

    def find(self, partials: Mapping[str, np.ndarray], eye: np.ndarray) -> None:
        """Take in the first view.

        Args:
            partials: part -> the points (m, 3) that are seen of it; all have to be there.
            eye: where the camera stood (3,).
        """
        for body in self._bodies:
            body.find(_View.of(self._thinned({name: partials[name] for name in body.parts}), eye))
            self._history |= {name: np.repeat(pose[None], 3, 0) for name, pose in body.placed().items()}

    def update(self, partials: Mapping[str, np.ndarray]) -> None:
        """Take in a later view; a joint whose part is hardly seen keeps its position."""
        least = self._config.min_points
        for body in self._bodies:
            body.follow(self._thinned({n: partials[n] for n in body.parts if len(partials.get(n, ())) >= least}))
            for name, pose in body.placed().items():
                self._history[name] = np.concatenate([pose[None], self._history[name][:2]])

    def _thinned(self, partials: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {name: thinned(points, self._config.max_points) for name, points in partials.items()}

    def around(self, point: np.ndarray) -> str | None:
        """The moving part in whose box, up to 2 cm over it, a point (3,) is; None where it is in none."""
        for name in self.moving:
            pose, part = self._history[name][0], self._parts[name]
            local = (point - pose[:3, 3]) @ pose[:3, :3]
            if bool(((local >= part.low) & (local <= part.high + [0.0, 0.0, _ABOVE])).all()):
                return name
        return None

    def inside(self, cloud: np.ndarray) -> np.ndarray:
        """Pose (4, 4) of a canonical cloud (n, 3) that stands in the first drawer: of an object that no view has shown.

        Raises:
            PwmGymError: no part slides, and could hide it.
        """
        if not self.hides:
            raise PwmGymError(
                f"none of {', '.join(self.moving) or 'no parts'} slides; expected a drawer that may hide it"
            )
        name = self._drawers[0]
        part, pose = self._parts[name], self._history[name][0].copy()
        place = np.append(0.5 * (part.low + part.high)[:2], part.low[2] + _INSIDE - cloud[:, 2].min())
        pose[:3, 3] += pose[:3, :3] @ place
        return pose


@dataclass(frozen=True, eq=False)
class _Part:
    """An entity's canonical cloud, what is asked of it, and its joint."""

    few: np.ndarray  # (m, 3) points of the cloud
    low: np.ndarray
    high: np.ndarray
    surface: Surface
    joint: Joint
    tree: JointTree

    @classmethod
    def of(cls, layout: Layout, name: str, cloud: np.ndarray, few: int) -> _Part:
        points, joint = np.asarray(cloud, np.float64), layout[name].joint
        tree = JointTree(layout, [layout.index(name)] if joint.moves else [])
        return cls(thinned(points, few), points.min(0), points.max(0), Surface.of(points), joint, tree)

    def local(self, positions: np.ndarray | float) -> np.ndarray:
        """Poses (..., 4, 4) in the body's frame at joint positions (...)."""
        return (
            self.tree.local(torch.as_tensor(positions, dtype=torch.float32)[..., None])[..., 0, :, :].double().numpy()
        )

    def seen(self, pose: np.ndarray, position: float, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (m, 3) in the part's frame, of a body at ``pose`` with its joint somewhere, and what the joint does.

        Returns:
            Places (m, 3), metres, and by how much they change with the joint's position (m, 3).
        """
        here, there = (_seen_from(pose @ local, points) for local in self.local(position + np.array([0.0, _TINY])))
        return here, (there - here) / _TINY

    def misfit(self, points: np.ndarray, pose: np.ndarray) -> float:
        """Mean distance of points (m, 3) to the cloud at a pose (4, 4), metres, each at most 3 cm."""
        distances, _ = self.surface.tree.query(_seen_from(pose, points), distance_upper_bound=_FAR)
        return float(np.minimum(distances, _FAR).mean())


@dataclass(frozen=True, eq=False)
class _View:
    """What a view shows of a body."""

    parts: Mapping[str, np.ndarray]  # part -> points (m, 3)
    points: np.ndarray  # (n, 3), of all parts
    tree: cKDTree  # of these
    eye: np.ndarray  # (3,)

    @classmethod
    def of(cls, parts: Mapping[str, np.ndarray], eye: np.ndarray) -> _View:
        points = np.concatenate(list(parts.values()))
        return cls(parts, points, cKDTree(points), np.asarray(eye, np.float64))


class _Body:
    """A resting body and the parts that hang on it: its pose, and the positions of its joints.

    Args:
        parts: the body itself, then its parts, by name.
        config: thresholds.
    """

    def __init__(self, parts: Mapping[str, _Part], config: TrackingConfig) -> None:
        self.parts, self._config = parts, config
        self._root, *self._hung = parts
        self._pose = np.eye(4)
        self._positions = dict.fromkeys(self._hung, 0.0)

    def placed(
        self, pose: np.ndarray | None = None, positions: Mapping[str, float] | None = None
    ) -> dict[str, np.ndarray]:
        """Poses (4, 4) of the body and its parts, as they are or with the body and its joints somewhere else."""
        pose = self._pose if pose is None else pose
        positions = self._positions if positions is None else positions
        return {self._root: pose, **{n: pose @ self.parts[n].local(positions[n]) for n in self._hung}}

    # The first view ---------------------------------------------------------------------------------------------------

    def find(self, view: _View) -> None:
        """Pose and joints that a view shows: of many guesses the best ones, refined."""
        guesses = []
        for share in np.linspace(0.0, 1.0, _OPEN):
            joints = {name: self.parts[name].joint for name in self._hung}
            positions = {name: joint.lower + share * (joint.upper - joint.lower) for name, joint in joints.items()}
            for yaw in np.linspace(0.0, 2.0 * np.pi, _YAWS, endpoint=False):
                guesses.append((self._upright(positions, view, yaw), positions))
        guesses.sort(key=lambda guess: self._misfit(guess[0], guess[1], view))
        refined = [self._refined(pose, positions, view) for pose, positions in guesses[:_REFINED]]
        self._pose, self._positions = min(refined, key=lambda found: self._misfit(found[0], found[1], view))

    def _upright(self, positions: Mapping[str, float], view: _View, yaw: float) -> np.ndarray:
        """Pose (4, 4) of a body that is turned by ``yaw``, its top and middle where those of what is seen are."""
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        whole = self._whole(self.placed(pose, positions))
        low, high = np.percentile(view.points, [2, 98], axis=0)
        pose[:3, 3] = 0.5 * (low + high) - 0.5 * (whole.min(0) + whole.max(0))
        pose[2, 3] = high[2] - whole[:, 2].max()
        return pose

    def _whole(self, placed: Mapping[str, np.ndarray]) -> np.ndarray:
        """Some points (n, 3) of the body and its parts, at poses (4, 4)."""
        return np.concatenate([self.parts[n].few @ p[:3, :3].T + p[:3, 3] for n, p in placed.items()])

    def _misfit(self, pose: np.ndarray, positions: Mapping[str, float], view: _View) -> float:
        """How ill a view fits, both ways: what is seen lies on the parts, and what would be seen of them is seen."""
        placed = self.placed(pose, positions)
        there = np.mean([self.parts[name].misfit(view.parts[name], place) for name, place in placed.items()])
        distances, _ = view.tree.query(seen_part(self._whole(placed), view.eye), distance_upper_bound=_FAR)
        return float(there + np.minimum(distances, _FAR).mean())

    def _refined(
        self, pose: np.ndarray, positions: Mapping[str, float], view: _View
    ) -> tuple[np.ndarray, dict[str, float]]:
        """A guess after Gauss-Newton steps of the body's pose and its joints together."""
        pose, found = pose.copy(), dict(positions)
        visible: dict[str, Surface] = {}
        for iteration in range(_ROUNDS):
            if iteration % _LOOK_AGAIN == 0:
                placed = self.placed(pose, found)
                visible = {name: part.surface.seen_from(placed[name], view.eye) for name, part in self.parts.items()}
            rows = [self._row(name, pose, found, view.parts[name], visible[name]) for name in self.parts]
            motion, way, normals, distances = (np.concatenate(part) for part in zip(*rows, strict=True))
            scale = float(np.clip(_TRIM * np.median(distances), self._config.gate, self._config.reach))
            spacing = max(surface.spacing for surface in visible.values())
            step = least_motion(motion, way, normals, surface_weights(distances, way, normals, scale, spacing))
            pose[:3, :3] = turned_back(pose[:3, :3], step[:3])
            pose[:3, 3] -= pose[:3, :3] @ step[3:6]
            for name, shift in zip(self._hung, step[6:], strict=True):
                found[name] = self._within(name, found[name] + shift)
        return pose, found

    def _row(
        self, name: str, pose: np.ndarray, positions: Mapping[str, float], points: np.ndarray, visible: Surface
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What the points (m, 3) of a part say in the body's frame.

        What the body's motion and its J joints do to them (m, 3, 6 + J), their ways (m, 3) to the surface, its normals
        (m, 3) there, and their distances (m,).
        """
        in_body = _seen_from(pose, points)
        motion = np.zeros((len(points), 3, 6 + len(self._hung)))
        motion[:, :, :6] = body_motion(in_body)
        if name == self._root:
            distances, way, normals = visible.match(in_body)
            return motion, way, normals, distances
        local, change = self.parts[name].seen(pose, positions[name], points)
        distances, way, normals = visible.match(local)
        turn = self.parts[name].local(positions[name])[:3, :3].T
        motion[:, :, 6 + self._hung.index(name)] = change @ turn
        return motion, way @ turn, normals @ turn, distances

    # Later ones -------------------------------------------------------------------------------------------------------

    def follow(self, seen: Mapping[str, np.ndarray]) -> None:
        """Joint positions that a later view shows, of the parts that are seen."""
        for name in self._hung:
            if name in seen:
                self._positions[name] = self._position(name, seen[name])

    def _position(self, name: str, points: np.ndarray) -> float:
        """Joint position near the last one at which points (m, 3) fit a part best."""
        part, reach = self.parts[name], _REACH[self.parts[name].joint.kind]
        tried, step = np.linspace(-reach, reach, _STEPS, retstep=True)
        best = self._best(name, points, self._positions[name] + tried)
        best = self._best(name, points, best + np.linspace(-step, step, _FINER))
        for _ in range(_NEWTON):  # by distances along the part's normals
            local, change = part.seen(self._pose, best, points)
            distances, way, normals = part.surface.match(local)
            weights = surface_weights(distances, way, normals, self._config.gate, part.surface.spacing)
            best = self._within(name, best + least_motion(change[:, :, None], way, normals, weights)[0])
        return best

    def _best(self, name: str, points: np.ndarray, tried: np.ndarray) -> float:
        """That of joint positions, or of the limits that they are beyond, at which points fit best."""
        part = self.parts[name]
        within = np.clip(tried, part.joint.lower, part.joint.upper)
        misfits = [part.misfit(points, self._pose @ local) for local in part.local(within)]
        return float(within[np.argmin(misfits)])

    def _within(self, name: str, position: float) -> float:
        joint = self.parts[name].joint
        return float(np.clip(position, joint.lower, joint.upper))


def _seen_from(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (m, 3) in the frame of a pose (4, 4)."""
    return np.asarray((points - pose[:3, 3]) @ pose[:3, :3])
