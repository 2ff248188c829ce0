"""Grasps of an object by a parallel gripper from above, found from its convex pieces alone.

For each of 24 directions of closing, a strip as wide as the fingers slides along the object and down it. Where the open
fingers fit beside the object, and the hand above it, what they would touch is scored. Lengths are in metres. The
canonical frame is the object's own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError
from pwm_gym.robots.gripper import PANDA, Gripper

if TYPE_CHECKING:
    import trimesh

__all__ = ["Grasp", "ObjectGrasps", "find_grasps"]

_YAWS = 24
_STRIDE = 0.004  # of the strip along the object
_DROP = 0.005  # of the strip down the object
_SAMPLES = 12_000  # points on the surface
_CLOUD = 3_000  # points kept to tell what is between the fingers
_LIKELY = 0.1  # least chance of a way to come to rest
_ALIKE = np.cos(np.radians(20))  # between two ways to rest that count as one
_RESTS = 3  # ways to rest
_TABLE = 0.003  # between the finger tips and the table
_SIDE = 0.0015  # between the fingers and what they pass by
_OVER = 0.003  # between the hand and what is below it
_EASE = 0.008  # wider than the object on each side, if there is room
_LEAST_EASE = 0.0015
_TOUCH = 0.002  # behind an outermost point, and still touched
_ALIGNED = 0.6  # least mean cosine between the touched surface and the direction of closing
_LEVER = 0.06  # of a grasp beside the centre of mass that costs as much as the best alignment gives
_COVERED = 0.4  # share of the pads that, when touched, is enough


@dataclass(frozen=True)
class Grasp:
    """One way to hold an object, in its canonical frame."""

    position: tuple[float, float, float]
    """Of the tool centre between the finger tips, metres."""
    closing: tuple[float, float, float]
    """Unit vector along which the fingers close."""
    approach: tuple[float, float, float]
    """Unit vector along which the tool comes, from the hand to the finger tips."""
    opening: float
    """Distance between the pads before they close, metres."""
    width: float
    """Of the object between the pads, metres."""
    score: float
    """Higher is better; about 1.5 at best."""


@dataclass(frozen=True)
class ObjectGrasps:
    """What an expert knows of an object."""

    grasps: tuple[Grasp, ...]
    """From the best to the worst."""
    cloud: np.ndarray
    """Surface points (N, 3) in the canonical frame, metres."""
    mass: float
    """Kilograms."""


@dataclass(frozen=True)
class _Object:
    """Surface of an object that rests on a table at z = 0."""

    points: np.ndarray  # (S, 3)
    normals: np.ndarray  # (S, 3)
    centre: np.ndarray  # (3,) of mass
    density: float  # points per square metre


@dataclass(frozen=True)
class _Strip:
    """Part of the surface that fingers at one place along the object may meet; columns are x, y (closing) and z."""

    points: np.ndarray  # (P, 3), x from the middle of the strip
    normals: np.ndarray  # (P,) along y
    under_hand: np.ndarray  # (Q, 2) y and z of what the hand may meet


def find_grasps(
    pieces: list[trimesh.Trimesh],
    gripper: Gripper = PANDA,
    count: int = 24,
    seed: int = 0,
    density: float = 1000.0,
) -> ObjectGrasps:
    """Ranked grasps from above of an object as the simulator places it (its z axis up), and as it may fall over.

    Args:
        pieces: convex meshes of the object, in its canonical frame, metres.
        gripper: fingers and hand.
        count: most grasps of each way to rest.
        seed: of the points on the surface.
        density: kilograms per cubic metre, which gives the mass.

    Raises:
        PwmGymError: there are no pieces.
    """
    import trimesh

    if not pieces:
        raise PwmGymError("cannot grasp an object of 0 pieces; expected at least one")
    found = [grasp for up in _resting(pieces) for grasp in _from_above(pieces, up, gripper, count, seed)]
    whole = trimesh.util.concatenate(pieces)
    cloud = trimesh.sample.sample_surface(whole, _CLOUD, seed=seed)[0]
    mass = density * sum(abs(piece.volume) for piece in pieces)
    return ObjectGrasps(tuple(found), cloud.astype(np.float32), float(mass))


def _resting(pieces: list[trimesh.Trimesh]) -> list[np.ndarray]:
    """Directions (3,) of the canonical frame that may point up: its z axis, and others in which the object rests."""
    import trimesh

    hull = trimesh.util.concatenate(pieces).convex_hull
    poses, chances = trimesh.poses.compute_stable_poses(hull, center_mass=_centre(pieces), sigma=0.0, n_samples=1)
    directions = [np.array([0.0, 0.0, 1.0])]
    for pose, chance in zip(poses, chances, strict=True):
        up = pose[2, :3]
        if chance >= _LIKELY and all(up @ known < _ALIKE for known in directions):
            directions.append(up)
    return directions[:_RESTS]


def _centre(pieces: list[trimesh.Trimesh]) -> np.ndarray:
    """Centre of mass (3,)."""
    volumes = np.array([abs(piece.volume) for piece in pieces])
    return np.average([piece.center_mass for piece in pieces], axis=0, weights=volumes)


def _from_above(
    pieces: list[trimesh.Trimesh], up: np.ndarray, gripper: Gripper, count: int, seed: int
) -> tuple[Grasp, ...]:
    """Ranked grasps of an object whose direction ``up`` points up."""
    turn = _upright(up)
    rested, bottom = _rest(pieces, turn, seed)
    found: list[tuple[float, Grasp]] = []
    for angle in np.arange(_YAWS) * np.pi / _YAWS:
        yaw = Rotation.from_euler("z", -angle)
        to_canonical = (yaw * turn).inv()
        for strip, middle in _strips(_turned(rested, yaw), gripper):
            for grasp in _of_strip(strip, middle, yaw.apply(rested.centre), rested.density, gripper):
                found.append((angle, _canonical(grasp, to_canonical, bottom)))
    return _best(found, count)


def _upright(up: np.ndarray) -> Rotation:
    """Smallest rotation of the canonical frame that lets ``up`` point up."""
    return Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0] if up[2] < 1 - 1e-9 else Rotation.identity()


def _rest(pieces: list[trimesh.Trimesh], turn: Rotation, seed: int) -> tuple[_Object, float]:
    """The object turned and put on the table, and how far below the origin its lowest point was."""
    import trimesh

    whole = trimesh.util.concatenate(pieces)
    points, faces = trimesh.sample.sample_surface(whole, _SAMPLES, seed=seed)
    points = turn.apply(points)
    bottom = float(turn.apply(whole.vertices)[:, 2].min())
    lift = np.array([0.0, 0.0, -bottom])
    normals = turn.apply(whole.face_normals[faces])
    return _Object(points + lift, normals, turn.apply(_centre(pieces)) + lift, _SAMPLES / whole.area), bottom


def _turned(rested: _Object, yaw: Rotation) -> _Object:
    return _Object(yaw.apply(rested.points), yaw.apply(rested.normals), yaw.apply(rested.centre), rested.density)


def _strips(rested: _Object, gripper: Gripper) -> Iterator[tuple[_Strip, float]]:
    """Strips along x, and where their middles are."""
    x = rested.points[:, 0]
    for middle in np.arange(x.min() + _STRIDE / 2, x.max(), _STRIDE):
        beside = np.abs(x - middle)
        near = beside <= gripper.finger_half_width + _SIDE
        below = rested.points[beside <= gripper.hand_half_width + _SIDE]
        points = rested.points[near] - [middle, 0.0, 0.0]
        if len(points) >= 8:
            yield _Strip(points, rested.normals[near, 1], below[:, 1:]), float(middle)


def _of_strip(
    strip: _Strip, middle: float, centre: np.ndarray, density: float, gripper: Gripper
) -> Iterator[tuple[np.ndarray, float, float, float]]:
    """Position (3,) of the tool, opening, width and score of each grasp in a strip."""
    for height in _heights(strip, gripper):
        deep = strip.points[:, 2] > height - gripper.finger_tip - _SIDE
        groups = _groups(strip.points[deep, 1], 2 * _LEAST_EASE + gripper.finger_depth)
        for left, low, high, right in groups:
            if high - low > gripper.opening - 2 * _LEAST_EASE:
                continue
            held = _held(strip, low, high, height, gripper)
            if held is None:
                continue
            y, score = held
            half = _half_opening(y, (left, low, high, right), gripper)
            if half is None or _blocked(strip.under_hand, y[0] + y[1], height, gripper):
                continue
            place = np.array([middle, (y[0] + y[1]) / 2, height])
            lever = float(np.hypot(*(place - centre)[:2]))
            yield place, 2 * half, y[1] - y[0], _rank(score, lever, strip, y, height, density, gripper)


def _heights(strip: _Strip, gripper: Gripper) -> np.ndarray:
    """Heights of the tool in a strip, without those at which the hand would hit a narrow object's top."""
    lowest = gripper.finger_tip + _TABLE
    heights = np.arange(lowest, max(float(strip.points[:, 2].max()), lowest + 1e-6), _DROP)
    if np.ptp(strip.under_hand[:, 0]) > gripper.hand_half_length:
        return heights
    return heights[heights >= strip.under_hand[:, 1].max() - gripper.hand_height + _OVER]


def _groups(y: np.ndarray, gap: float) -> list[tuple[float, float, float, float]]:
    """Runs of neighbouring ``y`` that fingers of the depth ``gap`` can enclose: free from, low, high, free to."""
    if not len(y):
        return []
    ordered = np.sort(y)
    breaks = np.flatnonzero(ordered[1:] - ordered[:-1] > gap)
    if not len(breaks):
        return [(-np.inf, ordered[0], ordered[-1], np.inf)]
    lows = np.concatenate([ordered[:1], ordered[breaks + 1]])
    highs = np.concatenate([ordered[breaks], ordered[-1:]])
    before = np.concatenate([[-np.inf], highs[:-1]])
    after = np.concatenate([lows[1:], [np.inf]])
    count = len(lows)
    return [(before[i], lows[i], highs[j], after[j]) for i in range(count) for j in range(i, count)]


def _held(
    strip: _Strip, low: float, high: float, height: float, gripper: Gripper
) -> tuple[tuple[float, float], float] | None:
    """Where the pads touch what is between ``low`` and ``high`` along y, and how squarely (0 to 1)."""
    at_pads = _at_pads(strip, height, gripper) & (strip.points[:, 1] >= low) & (strip.points[:, 1] <= high)
    if at_pads.sum() < 4:
        return None
    y, normals = strip.points[at_pads, 1], strip.normals[at_pads]
    first, last = float(y.min()), float(y.max())
    if last - first > gripper.opening - 2 * _LEAST_EASE:
        return None
    at_first = np.maximum(-normals[y < first + _TOUCH], 0).mean()
    at_last = np.maximum(normals[y > last - _TOUCH], 0).mean()
    squareness = float(min(at_first, at_last))
    return ((first, last), squareness) if squareness >= _ALIGNED else None


def _at_pads(strip: _Strip, height: float, gripper: Gripper) -> np.ndarray:
    """Which points (P,) of the strip the pads may press on."""
    level = np.abs(strip.points[:, 2] - height) <= gripper.finger_tip
    return level & (np.abs(strip.points[:, 0]) <= gripper.pad_half_width)


def _half_opening(
    touched: tuple[float, float], free: tuple[float, float, float, float], gripper: Gripper
) -> float | None:
    """Half the opening with which the fingers come down beside the object, if they fit."""
    middle = (touched[0] + touched[1]) / 2
    left, low, high, right = free
    least = max(high - middle, middle - low) + _LEAST_EASE
    room = min(right - middle, middle - left) - gripper.finger_depth - _LEAST_EASE
    most = min(gripper.opening / 2, room)
    return min(least - _LEAST_EASE + _EASE, most) if least <= most else None


def _blocked(under_hand: np.ndarray, doubled: float, height: float, gripper: Gripper) -> bool:
    """Whether the hand would touch the object."""
    below = np.abs(under_hand[:, 0] - doubled / 2) <= gripper.hand_half_length + _SIDE
    return bool((under_hand[below, 1] > height + gripper.hand_height - _OVER).any())


def _rank(
    squareness: float,
    lever: float,
    strip: _Strip,
    touched: tuple[float, float],
    height: float,
    density: float,
    gripper: Gripper,
) -> float:
    """Score: squareness and covered pads, less what lies beside the centre of mass."""
    y = strip.points[_at_pads(strip, height, gripper), 1]
    pad = 2 * gripper.pad_half_width * 2 * gripper.finger_tip * density  # points on a covered pad
    fewest = min((np.abs(y - side) < _TOUCH).sum() for side in touched)
    return squareness + 0.5 * min(1.0, fewest / (_COVERED * pad)) - lever / _LEVER


def _canonical(grasp: tuple[np.ndarray, float, float, float], back: Rotation, bottom: float) -> Grasp:
    place, opening, width, score = grasp
    position = back.apply(place + [0.0, 0.0, bottom])
    closing = back.apply([0.0, 1.0, 0.0])
    approach = back.apply([0.0, 0.0, -1.0])
    return Grasp(_floats(position), _floats(closing), _floats(approach), float(opening), float(width), float(score))


def _floats(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 6) for v in vector)
    return x, y, z


def _best(found: list[tuple[float, Grasp]], count: int) -> tuple[Grasp, ...]:
    """The best grasps, at most three of one yaw, so that some suits any pose."""
    taken: dict[float, int] = {}
    kept: list[Grasp] = []
    for angle, grasp in sorted(found, key=lambda pair: -pair[1].score):
        if taken.get(angle, 0) < 3 and len(kept) < count:
            taken[angle] = taken.get(angle, 0) + 1
            kept.append(grasp)
    return tuple(kept)
