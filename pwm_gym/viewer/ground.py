"""The table under a cloud: a plane with a grid, soft contact shadows and the goal's ring."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pwm_gym.viewer.camera import Camera
from pwm_gym.viewer.palette import GOAL, Color

__all__ = ["draw_ground"]

_TABLE = np.array([232, 236, 239], dtype=np.float32) / 255
_LINE = np.array([196, 204, 210], dtype=np.float32) / 255
_SHADOW = np.array([52, 66, 82], dtype=np.float32) / 255
_SPACING = 0.05  # metres between grid lines; every second one is strong
_CELLS = 160  # at most so many shadow cells a side


def draw_ground(
    points: np.ndarray,
    camera: Camera,
    radius: float,
    background: Color,
    height: float | None,
    goal: np.ndarray | None,
    goal_radius: float,
) -> np.ndarray:
    """Image (H, W, 3) float32 of 1: what lies behind points (N, 3) of a ``radius`` in metres."""
    if height is None:
        size = (camera.height, camera.width, 3)
        return np.broadcast_to(np.float32(background) / 255, size).copy()
    table, plane, pixel = _table(camera, background, height)
    image = table.copy()
    _darken(image, plane, points[points[:, 2] > height - radius], radius, height)
    if goal is not None:
        _ring(image, plane, pixel, goal[:2], goal_radius)
    return image


@lru_cache(maxsize=8)
def _table(camera: Camera, background: Color, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The empty table (H, W, 3), each pixel's place on it (H, W, 2) and size on it (H, W), metres (NaN: none)."""
    rays = camera.rays()
    drop = height - camera.eye[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = drop / rays[..., 2]
    along = np.where((along > 0) & np.isfinite(along), along, np.nan)
    plane = np.array(camera.eye[:2]) + along[..., None] * rays[..., :2]
    slant = np.abs(rays[..., 2]) / np.linalg.norm(rays, axis=-1)
    pixel = along / camera.focal / np.maximum(np.sqrt(slant), 1e-3)  # between the footprint's two sides
    focus = np.linalg.norm(plane - np.array(camera.target[:2]), axis=-1)
    reach = np.linalg.norm(np.subtract(camera.target, camera.eye)) * np.tan(np.radians(camera.fov) / 2)
    fade = np.nan_to_num(np.exp(-((focus / (1.9 * reach)) ** 4)))[..., None]
    image = _TABLE + (_LINE - _TABLE) * _grid(plane, pixel)[..., None]
    image = np.float32(background) / 255 * (1 - fade) + np.nan_to_num(image) * fade
    return image.astype(np.float32), plane.astype(np.float32), pixel.astype(np.float32)


def _grid(plane: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """Strength (H, W) of grid lines, one pixel wide and smooth."""
    strength = np.zeros(pixel.shape)
    for spacing, weight in ((_SPACING, 0.45), (2 * _SPACING, 1.0)):
        offset = np.abs((plane / spacing + 0.5) % 1 - 0.5) * spacing
        line = np.clip(1.1 - offset.min(-1) / pixel, 0, 1) * np.clip(spacing / (6 * pixel), 0, 1)
        strength = np.maximum(strength, weight * line)
    return strength


def _darken(image: np.ndarray, plane: np.ndarray, points: np.ndarray, radius: float, height: float) -> None:
    """Soft shadows of points straight above the table: small and dark at contact, wide and faint from above."""
    if not len(points):
        return
    low, high = points[:, :2].min(0) - 0.08, points[:, :2].max(0) + 0.08
    cell = max(0.004, float((high - low).max()) / _CELLS)
    shape = tuple(int(n) for n in np.ceil((high - low) / cell).astype(int) + 1)
    place = ((points[:, :2] - low) / cell + 0.5).astype(int)
    flat = place[:, 0] * shape[1] + place[:, 1]
    over = np.maximum(points[:, 2] - height, 0)
    contact = np.exp(-over / 0.03)
    share = np.pi * (1.6 * radius / cell) ** 2  # cells that one point covers
    dark = np.zeros(shape)
    for weight, blur in ((contact, 0.006), (0.55 * np.exp(-over / 0.30) * (1 - contact), 0.020)):
        mass = np.bincount(flat, weight, shape[0] * shape[1]).reshape(shape)
        dark += share * _blur(mass, blur / cell)
    texture = (0.50 * (1 - np.exp(-0.6 * dark))).astype(np.float32)
    _apply(image, plane, texture, low, cell)


def _blur(texture: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur (h, w) with a standard deviation in cells."""
    reach = max(1, int(np.ceil(3 * sigma)))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-3)) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        width = [(0, 0), (0, 0)]
        width[axis] = (reach, reach)
        padded = np.pad(texture, width)
        size = texture.shape[axis]
        texture = sum(
            (k * padded.take(range(i, i + size), axis) for i, k in enumerate(kernel)), np.zeros(texture.shape)
        )
    return texture


def _apply(image: np.ndarray, plane: np.ndarray, texture: np.ndarray, low: np.ndarray, cell: float) -> None:
    """Darken the pixels of ``image`` by the shadow texture (h, w) at their place on the table (bilinear)."""
    with np.errstate(invalid="ignore"):
        at = (plane - low.astype(np.float32)) / np.float32(cell)
        inside = ((at >= 0) & (at < np.array(texture.shape) - 1)).all(-1)
    at = at[inside]
    corner = at.astype(np.int64)
    a, b = (at - corner).T
    i, j = corner.T
    top = texture[i, j] * (1 - b) + texture[i, j + 1] * b
    bottom = texture[i + 1, j] * (1 - b) + texture[i + 1, j + 1] * b
    alpha = (top * (1 - a) + bottom * a)[:, None]
    image[inside] = image[inside] * (1 - alpha) + _SHADOW * alpha


def _ring(image: np.ndarray, plane: np.ndarray, pixel: np.ndarray, centre: np.ndarray, radius: float) -> None:
    """A thin green ring on the table below the goal."""
    distance = np.linalg.norm(plane - centre.astype(np.float32), axis=-1)
    alpha = np.nan_to_num(np.clip(1.4 - np.abs(distance - radius) / pixel, 0, 1))
    alpha = np.maximum(0.75 * alpha, 0.12 * (distance < radius))[..., None]
    image[:] = image * (1 - alpha) + np.float32(GOAL) / 255 * alpha
