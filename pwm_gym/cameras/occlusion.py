"""Random occluders for training data.

The authors of 3D Point World Models name the missing occlusion by other objects in the training data of their point
completion as the main cause of its failures; this cuts such occlusions out of an object's visible pixels.
"""

from __future__ import annotations

import numpy as np

from pwm_gym.errors import PwmGymError

__all__ = ["occlude"]


def occlude(mask: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """What is left (H, W) of an object's visible pixels behind an occluder that hides about ``share`` of them.

    The occluder is a half-plane that comes from a side, a bar that crosses the object, or a convex polygon about a
    point on or beside it, each as likely. It hides as many pixels as asked for, except where several lie exactly on
    its edge; it never hides all, and an empty mask stays empty.

    Args:
        mask: the object's visible pixels (H, W), bool.
        share: of the pixels, 0 to 1.
        rng: decides the occluder.

    Raises:
        PwmGymError: the mask is no bool image, or the share lies outside 0 to 1.
    """
    if mask.ndim != 2 or mask.dtype != np.bool_:
        raise PwmGymError(f"the mask has shape {mask.shape} and type {mask.dtype}; expected (H, W) and bool")
    if not 0.0 <= share <= 1.0:
        raise PwmGymError(f"share is {share}; expected 0 to 1")
    pixels = np.argwhere(mask).astype(np.float64)  # (M, 2)
    if not len(pixels):
        return mask.copy()
    size = _size(pixels, rng)
    count = min(round(share * len(pixels)), len(pixels) - 1)
    left = np.zeros_like(mask)
    # The occluder's size that hides `count` pixels: bisection would find the same number.
    left[mask] = size >= np.partition(size, count)[count]
    return left


def _size(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Size (M,) that a random occluder needs to reach each pixel (M, 2); its sides have normals and unequal reaches."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    centre = pixels[rng.integers(len(pixels))]
    kind = rng.integers(3)
    if kind == 0:
        angles, reach = np.array([angle]), np.ones(1)
    elif kind == 1:
        angles, reach = np.array([angle, angle + np.pi]), np.ones(2)
    else:
        sides = int(rng.integers(3, 8))
        spread = np.arange(sides) + rng.uniform(-0.25, 0.25, sides)
        angles, reach = angle + spread * 2.0 * np.pi / sides, rng.uniform(0.5, 1.5, sides)
        centre = centre + rng.uniform(-0.5, 0.5, 2) * (np.ptp(pixels, axis=0) + 1.0)
    normals = np.stack([np.cos(angles), np.sin(angles)], 1)  # (sides, 2)
    return ((pixels - centre) @ normals.T / reach).max(1)
