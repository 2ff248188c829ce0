"""Pinhole cameras of the viewer, and where to put one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pwm_gym.errors import PwmGymError

__all__ = ["Camera", "check_points", "frame_camera", "tabletop_camera"]

_NEAR = 0.01  # metres; nearer points are not drawn
# Corners (8, 3) of the PickCube work area, metres.
_WORKSPACE = np.array([[x, y, z] for x in (0.45, 0.8) for y in (-0.2, 0.2) for z in (0.0, 0.35)])


@dataclass(frozen=True)
class Camera:
    """Pinhole camera in the world frame, looking from ``eye`` at ``target``; square pixels, no distortion.

    Example:
        >>> camera = Camera(eye=(0, -1, 0), target=(0, 0, 0), width=200, height=100)
        >>> camera.project(np.zeros((1, 3))).tolist()
        [[100.0, 50.0, 1.0]]
    """

    eye: tuple[float, float, float]
    """Position, metres."""
    target: tuple[float, float, float]
    """Point at the image's centre, metres."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction that is up in the image."""
    fov: float = 35.0
    """Vertical field of view, degrees."""
    width: int = 320
    """Image width, pixels."""
    height: int = 320
    """Image height, pixels."""

    def __post_init__(self) -> None:
        """Reject a camera that has no image."""
        if not 0 < self.fov < 180:
            raise PwmGymError(f"fov={self.fov} degrees; expected between 0 and 180")
        if min(self.width, self.height) < 1:
            raise PwmGymError(f"an image of {self.width} x {self.height} pixels; expected at least 1 x 1")
        forward = np.subtract(self.target, self.eye)
        if np.linalg.norm(np.cross(forward, self.up)) < 1e-9:
            raise PwmGymError(f"up={self.up} is along the line of sight {tuple(forward.tolist())}")

    @cached_property
    def axes(self) -> np.ndarray:
        """Rows (3, 3): the image's right, down and the line of sight, unit vectors in the world frame."""
        forward = np.subtract(self.target, self.eye).astype(np.float64)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward])

    @cached_property
    def focal(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.height / float(np.tan(np.radians(self.fov) / 2))

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixel coordinates and depth (N, 3) of world points (N, 3).

        Columns are u (right) and v (down) in pixels from the upper left corner of the image, and depth along
        the line of sight in metres. u and v are NaN for points behind the camera or within 1 cm of it.
        """
        seen = (np.asarray(points, dtype=np.float64) - self.eye) @ self.axes.T
        depth = seen[:, 2]
        scale = self.focal / np.where(depth > _NEAR, depth, np.nan)
        return np.stack([0.5 * self.width + scale * seen[:, 0], 0.5 * self.height + scale * seen[:, 1], depth], 1)

    def rays(self) -> np.ndarray:
        """Directions (H, W, 3) through the pixels' centres, world frame, of unit depth."""
        u = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal
        v = (np.arange(self.height) + 0.5 - 0.5 * self.height) / self.focal
        return u[None, :, None] * self.axes[0] + v[:, None, None] * self.axes[1] + self.axes[2]

    def scaled(self, factor: int) -> Camera:
        """The same view with ``factor`` times the pixels in each direction."""
        return replace(self, width=self.width * factor, height=self.height * factor)


def check_points(points: np.ndarray, name: str = "points") -> np.ndarray:
    """``points`` as an array (..., 3), float64.

    Raises:
        PwmGymError: the shape is wrong, or some points are not finite (it says how many).
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim < 1 or points.shape[-1] != 3:
        raise PwmGymError(f"{name} has shape {points.shape}; expected (..., 3)")
    bad = int((~np.isfinite(points)).any(-1).sum())
    if bad:
        raise PwmGymError(f"{bad} of {points[..., 0].size} {name} are not finite")
    return points


def frame_camera(
    *clouds: np.ndarray,
    width: int = 320,
    height: int = 320,
    azimuth: float = -52.0,
    elevation: float = 26.0,
    fov: float = 28.0,
    margin: float = 0.06,
    ground: float | None = 0.0,
) -> Camera:
    """Camera that sees every point of ``clouds`` (..., 3) (a trajectory, a goal), and their shadows.

    The view is three-quarter from the front and side: a robot at the origin that faces x looks towards it.

    Args:
        clouds: points in metres, world frame; without any, the tabletop work area.
        width: image width, pixels.
        height: image height, pixels.
        azimuth: where the camera stands around the scene, degrees from the x axis towards y.
        elevation: its height over the horizon, degrees.
        fov: vertical field of view, degrees.
        margin: part of the image left free at every border.
        ground: height of the plane that takes shadows, metres; None for no plane.

    Raises:
        PwmGymError: some points are not finite.
    """
    parts = [check_points(c).reshape(-1, 3) for c in clouds]
    points = np.concatenate(parts) if parts else _WORKSPACE
    corners = _corners(points if len(points) else _WORKSPACE, ground)
    turn, lift = np.radians([azimuth, elevation])
    back = np.array([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)])
    probe = Camera(eye=_triple(back), target=(0.0, 0.0, 0.0), fov=fov, width=width, height=height)
    slope = (1 - 2 * margin) * np.array([width, height]) / (2 * probe.focal)  # tangents of the half angles
    seen = corners @ probe.axes.T  # right, down, along the line of sight
    # Each of the frustum's four sides gives its nearest admissible apex; opposite sides share what is free.
    high = (seen[:, :2] - slope * seen[:, 2:]).max(0)
    low = (-seen[:, :2] - slope * seen[:, 2:]).max(0)
    centre, needed = (high - low) / 2, (high + low) / (2 * slope)
    distance = max(float(needed.max()), _NEAR - float(seen[:, 2].min()) + 0.1)  # eye to the axes' origin
    eye = np.array([centre[0], centre[1], -distance]) @ probe.axes
    middle = float(seen[:, 2].mean())
    target = np.array([centre[0], centre[1], middle]) @ probe.axes
    return Camera(eye=_triple(eye), target=_triple(target), fov=fov, width=width, height=height)


def tabletop_camera(width: int = 320, height: int = 320) -> Camera:
    """Default view of a Panda's work area: x 0.45 to 0.8, y -0.2 to 0.2, z 0 to 0.35 m, base frame."""
    return frame_camera(width=width, height=height)


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in vector)
    return x, y, z


def _corners(points: np.ndarray, ground: float | None) -> np.ndarray:
    """Points (M, 3) whose view decides the fit: the cloud, and its footprint on the ground."""
    if ground is None:
        return points
    footprint = points.copy()
    footprint[:, 2] = ground
    return np.concatenate([points, footprint])
