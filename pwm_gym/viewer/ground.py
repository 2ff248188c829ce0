"""The table under a cloud: a plane with a grid, soft contact shadows and the goal's ring."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from PIL import Image

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
        return np.broadcast_to(np.array(background, dtype=np.float32) / 255, size).copy()
    table, plane, pixel = _table(camera, background, height)
    image = table.copy()
    shadow = _shadow(points[points[:, 2] > height - radius], radius, height)
    if shadow is not None:
        texture, low, cell = shadow
        area = _area(camera, low, low + (np.array(texture.shape) - 1) * cell, height)
        alpha = _warp(texture, low, cell, camera, height, area) * np.isfinite(pixel[area])
        image[area] += (_SHADOW - image[area]) * alpha[..., None]
    if goal is not None:
        area = _area(camera, goal[:2] - 1.5 * goal_radius, goal[:2] + 1.5 * goal_radius, height)
        _ring(image[area], plane[area], pixel[area], goal[:2], goal_radius)
    return image


def _area(camera: Camera, low: np.ndarray, high: np.ndarray, height: float) -> tuple[slice, slice]:
    """Rows and columns of the image that hold the table's rectangle from ``low`` to ``high``, (2,) metres."""
    corners = np.array([[x, y, height] for x in (low[0], high[0]) for y in (low[1], high[1])])
    seen = camera.project(corners)[:, :2]
    if not np.isfinite(seen).all():  # it reaches behind the camera
        return slice(None), slice(None)
    left, top = np.clip(np.floor(seen.min(0)), 0, (camera.width, camera.height)).astype(int)
    right, bottom = np.clip(np.ceil(seen.max(0)), 0, (camera.width, camera.height)).astype(int)
    return slice(top, bottom), slice(left, right)


@lru_cache(maxsize=8)
def _table(camera: Camera, background: Color, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The empty table (H, W, 3); each pixel's place (H, W, 2) and size (H, W) on it, metres (NaN: none)."""
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
    image = np.array(background, dtype=np.float32) / 255 * (1 - fade) + np.nan_to_num(image) * fade
    return image.astype(np.float32), plane.astype(np.float32), pixel.astype(np.float32)


def _grid(plane: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """Strength (H, W) of grid lines, one pixel wide and smooth."""
    strength = np.zeros(pixel.shape)
    for spacing, weight in ((_SPACING, 0.45), (2 * _SPACING, 1.0)):
        offset = np.abs((plane / spacing + 0.5) % 1 - 0.5) * spacing
        line = np.clip(1.1 - offset.min(-1) / pixel, 0, 1) * np.clip(spacing / (6 * pixel), 0, 1)
        strength = np.maximum(strength, weight * line)
    return strength


def _shadow(points: np.ndarray, radius: float, height: float) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Opacity texture (h, w) of the shadows straight below points, its corner (2,) and cell size in metres.

    Small and dark at contact, wide and faint from above.
    """
    if not len(points):
        return None
    low, high = points[:, :2].min(0) - 0.08, points[:, :2].max(0) + 0.08
    cell = max(0.004, float((high - low).max()) / _CELLS)
    shape = tuple(int(n) for n in np.ceil((high - low) / cell) + 1)
    place = ((points[:, :2] - low) / cell + 0.5).astype(int)
    flat = place[:, 0] * shape[1] + place[:, 1]
    over = np.maximum(points[:, 2] - height, 0)
    contact = np.exp(-over / 0.03)
    share = np.pi * (1.6 * radius / cell) ** 2  # cells that one point covers
    dark = np.zeros(shape)
    for weight, blur in ((contact, 0.006), (0.55 * np.exp(-over / 0.30) * (1 - contact), 0.020)):
        mass = np.bincount(flat, weight, shape[0] * shape[1]).reshape(shape)
        dark += share * _blur(mass, blur / cell)
    return (0.50 * (1 - np.exp(-0.6 * dark))).astype(np.float32), low, cell


def _blur(texture: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur (h, w) with a standard deviation in cells."""
    for axis in (0, 1):
        place = np.arange(texture.shape[axis], dtype=np.float64)
        kernel = np.exp(-0.5 * ((place[:, None] - place) / max(sigma, 1e-3)) ** 2)
        kernel /= kernel.sum(1).max()
        texture = kernel @ texture if axis == 0 else texture @ kernel
    return texture


def _warp(
    texture: np.ndarray,
    low: np.ndarray,
    cell: float,
    camera: Camera,
    height: float,
    area: tuple[slice, slice],
) -> np.ndarray:
    """The table's texture (h, w) as the camera sees it in ``area``: a homography, sampled by Pillow."""
    top, bottom, _ = area[0].indices(camera.height)
    left, right, _ = area[1].indices(camera.width)
    right_axis, down, forward = camera.axes
    corner = (left - camera.width / 2) * right_axis + (top - camera.height / 2) * down + camera.focal * forward
    ray = np.stack([right_axis, down, corner], 1)  # columns: of (u, v, 1), the pixel counted from the area's corner
    start = (np.array(camera.eye[:2]) - low) / cell + 0.5
    x, y = (start[i] * ray[2] + (height - camera.eye[2]) / cell * ray[i] for i in (0, 1))
    terms = np.concatenate([y, x, ray[2]]) / (ray[2, 2] or 1e-9)
    image = Image.fromarray(texture).transform(
        (right - left, bottom - top),
        Image.Transform.PERSPECTIVE,
        terms[:8].tolist(),
        Image.Resampling.BILINEAR,
    )
    return np.asarray(image)


def _ring(image: np.ndarray, plane: np.ndarray, pixel: np.ndarray, centre: np.ndarray, radius: float) -> None:
    """A thin green ring on the table below the goal."""
    distance = np.hypot(plane[..., 0] - np.float32(centre[0]), plane[..., 1] - np.float32(centre[1]))
    alpha = np.nan_to_num(np.clip(1.4 - np.abs(distance - radius) / pixel, 0, 1))
    alpha = np.maximum(0.75 * alpha, 0.12 * (distance < radius))[..., None]
    image[:] = image * (1 - alpha) + np.array(GOAL, dtype=np.float32) / 255 * alpha
