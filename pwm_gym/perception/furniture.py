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
    turned_back,
)
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Joint, Layout

__all__ = ["Furniture", "furniture_names"]

_YAWS, _OPEN = 24, 5  # turns about the vertical, and positions of the joints, that are tried at first
_REFINED = 4  # of these guesses are refined
_ROUNDS, _LOOK_AGAIN = 40, 8  # Gauss-Newton steps of a guess, and after how many what is visible is told anew
_FAR = 0.03  # metres: a point farther from the cloud counts as that far
_MOST = 400  # points of a view, and of a cloud, that are compared
_REACH = {"prismatic": 0.04, "revolute": 0.35}  # metres and radians that a joint moves between two views, at the most
_STEPS, _FINER = 25, 11  # positions that are tried, and then between the best one's neighbours
_NEWTON, _TINY, _DAMPING = 6, 1e-4, 1e-3  # Gauss-Newton steps of a joint, a slope's shift, and what keeps steps small
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
        self.names = furniture_names(layout)
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
        self._parts = {name: _Part.of(layout, name, clouds[name]) for name in self.names}
        self._bodies = [_Body({n: self._parts[n] for n in (root, *parts)}, config) for root, parts in hung.items()]
        self._least = config.min_points
        self._history: dict[str, np.ndarray] = {}

    def __contains__(self, name: str) -> bool:
        """Whether an entity is a part of one of the bodies."""
        return name in self._parts

    @property
    def hides(self) -> bool:
        """Whether a part slides, in which an object may be hidden."""
        return any(part.joint.kind == "prismatic" for part in self._parts.values())

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
            body.find({name: _thin(partials[name]) for name in body.parts}, np.asarray(eye, np.float64))
            self._history |= {name: np.repeat(pose[None], 3, 0) for name, pose in body.placed().items()}

    def update(self, partials: Mapping[str, np.ndarray]) -> None:
        """Take in a later view; a joint whose part is hardly seen keeps its position."""
        for body in self._bodies:
            body.follow({n: _thin(partials[n]) for n in body.parts if len(partials.get(n, ())) >= self._least})
            for name, pose in body.placed().items():
                self._history[name] = np.concatenate([pose[None], self._history[name][:2]])

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
        drawers = [name for name in self.moving if self._parts[name].joint.kind == "prismatic"]
        if not drawers:
            raise PwmGymError(
                f"none of {', '.join(self.moving) or 'no parts'} slides; expected a drawer that may hide it"
            )
        part, pose = self._parts[drawers[0]], self._history[drawers[0]][0].copy()
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
    def of(cls, layout: Layout, name: str, cloud: np.ndarray) -> _Part:
        points, joint = np.asarray(cloud, np.float64), layout[name].joint
        tree = JointTree(layout, [layout.index(name)] if joint.moves else [])
        return cls(_thin(points), points.min(0), points.max(0), Surface.of(points), joint, tree)

    def local(self, position: float) -> np.ndarray:
        """Pose (4, 4) in the body's frame at a joint position."""
        return self.tree.local(torch.tensor([position], dtype=torch.float32))[0].double().numpy()

    def misfit(self, points: np.ndarray, pose: np.ndarray) -> float:
        """Mean distance of points (m, 3) to the cloud at a pose (4, 4), metres, each at most 3 cm."""
        distances, _ = self.surface.tree.query(_seen_from(pose, points), distance_upper_bound=_FAR)
        return float(np.minimum(distances, _FAR).mean())


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

    def find(self, seen: Mapping[str, np.ndarray], eye: np.ndarray) -> None:
        """Pose and joints that a view shows: of many guesses the best ones, refined."""
        guesses = []
        for share in np.linspace(0.0, 1.0, _OPEN):
            joints = {name: self.parts[name].joint for name in self._hung}
            positions = {name: joint.lower + share * (joint.upper - joint.lower) for name, joint in joints.items()}
            for yaw in np.linspace(0.0, 2.0 * np.pi, _YAWS, endpoint=False):
                guess = (self._upright(positions, seen, yaw), positions)
                guesses.append((self._misfit(*guess, seen, eye), guess))
        guesses.sort(key=lambda found: found[0])
        refined = [self._refined(*guess, seen, eye) for _, guess in guesses[:_REFINED]]
        self._pose, self._positions = min(refined, key=lambda found: self._misfit(found[0], found[1], seen, eye))

    def _upright(self, positions: Mapping[str, float], seen: Mapping[str, np.ndarray], yaw: float) -> np.ndarray:
        """Pose (4, 4) of a body that is turned by ``yaw``, its top and middle where those of what is seen are."""
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        whole = self._whole(pose, positions)
        low, high = np.percentile(np.concatenate(list(seen.values())), [2, 98], axis=0)
        pose[:3, 3] = 0.5 * (low + high) - 0.5 * (whole.min(0) + whole.max(0))
        pose[2, 3] = high[2] - whole[:, 2].max()
        return pose

    def _whole(self, pose: np.ndarray, positions: Mapping[str, float]) -> np.ndarray:
        """Some points (n, 3) of the body and its parts."""
        placed = self.placed(pose, positions)
        return np.concatenate([self.parts[n].few @ p[:3, :3].T + p[:3, 3] for n, p in placed.items()])

    def _misfit(
        self, pose: np.ndarray, positions: Mapping[str, float], seen: Mapping[str, np.ndarray], eye: np.ndarray
    ) -> float:
        """How ill the views fit, both ways: what is seen lies on the parts, and what would be seen of them is seen."""
        placed = self.placed(pose, positions)
        there = np.mean([self.parts[name].misfit(seen[name], place) for name, place in placed.items()])
        points = cKDTree(np.concatenate(list(seen.values())))
        distances, _ = points.query(seen_part(self._whole(pose, positions), eye), distance_upper_bound=_FAR)
        return float(there + np.minimum(distances, _FAR).mean())

    def _refined(
        self, pose: np.ndarray, positions: Mapping[str, float], seen: Mapping[str, np.ndarray], eye: np.ndarray
    ) -> tuple[np.ndarray, dict[str, float]]:
        """A guess after Gauss-Newton steps of the body's pose and its joints together."""
        pose, found = pose.copy(), dict(positions)
        visible: dict[str, Surface] = {}
        for iteration in range(_ROUNDS):
            if iteration % _LOOK_AGAIN == 0:
                placed = self.placed(pose, found)
                visible = {name: part.surface.seen_from(placed[name], eye) for name, part in self.parts.items()}
            rows = [self._row(k, pose, found, points, visible[n]) for k, (n, points) in enumerate(seen.items())]
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
        self, k: int, pose: np.ndarray, positions: Mapping[str, float], points: np.ndarray, visible: Surface
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What the points (m, 3) of part ``k`` say in the body's frame.

        What the body's motion and its J joints do to them (m, 3, 6 + J), their ways (m, 3) to the surface, its normals
        (m, 3) there, and their distances (m,).
        """
        name = list(self.parts)[k]
        place = self.placed(pose, positions)[name]
        local = _seen_from(place, points)
        distances, way, normals = visible.match(local)
        turn = place[:3, :3].T @ pose[:3, :3]
        motion = np.zeros((len(points), 3, 6 + len(self._hung)))
        motion[:, :, :6] = body_motion(_seen_from(pose, points))
        if k:
            moved = _seen_from(pose @ self.parts[name].local(positions[name] + _TINY), points)
            motion[:, :, 5 + k] = (moved - local) / _TINY @ turn
        return motion, way @ turn, normals @ turn, distances

    # Later ones -------------------------------------------------------------------------------------------------------

    def follow(self, seen: Mapping[str, np.ndarray]) -> None:
        """Joint positions that a later view shows, of the parts that are seen."""
        for name in self._hung:
            if name in seen:
                self._positions[name] = self._position(name, seen[name])

    def _position(self, name: str, points: np.ndarray) -> float:
        """Joint position near the last one at which points (m, 3) fit a part best."""
        reach = _REACH[self.parts[name].joint.kind]
        tried = np.linspace(-reach, reach, _STEPS)
        best = self._best(name, points, self._positions[name] + tried)
        best = self._best(name, points, best + np.linspace(tried[0] - tried[1], tried[1] - tried[0], _FINER))
        return self._exact(name, points, best)

    def _best(self, name: str, points: np.ndarray, tried: np.ndarray) -> float:
        """That of joint positions, or of the limits that they are beyond, at which points fit best."""
        part, within = self.parts[name], [self._within(name, q) for q in tried]
        return min(within, key=lambda q: part.misfit(points, self._pose @ part.local(q)))

    def _exact(self, name: str, points: np.ndarray, position: float) -> float:
        """A joint position after some Gauss-Newton steps, by distances along the part's normals."""
        part = self.parts[name]
        for _ in range(_NEWTON):
            local, moved = (_seen_from(self._pose @ part.local(position + d), points) for d in (0.0, _TINY))
            distances, way, normals = part.surface.match(local)
            near = distances < self._config.gate + 1.5 * part.surface.spacing
            slope = ((moved - local) * normals).sum(1)[near] / _TINY
            gap = (way * normals).sum(1)[near]
            position = self._within(name, position + (slope * gap).sum() / (np.square(slope).sum() + _DAMPING))
        return position

    def _within(self, name: str, position: float) -> float:
        joint = self.parts[name].joint
        return float(np.clip(position, joint.lower, joint.upper))


def _seen_from(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (m, 3) in the frame of a pose (4, 4)."""
    return np.asarray((points - pose[:3, 3]) @ pose[:3, :3])


def _thin(points: np.ndarray) -> np.ndarray:
    """At most 400 of points (m, 3)."""
    return points[:: -(-len(points) // _MOST)]
