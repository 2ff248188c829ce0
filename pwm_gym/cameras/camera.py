"""Calibrated pinhole cameras: pixels, depth and points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwm_gym.errors import PwmGymError

__all__ = ["DepthCamera", "check_pose"]


@dataclass(frozen=True, eq=False)
class DepthCamera:
    """Pinhole camera without distortion; x is right in the image, y down, z into the scene (OpenCV's frame).

    Raises:
        PwmGymError: intrinsics that are not (3, 3) or have no focal length, or extrinsics that are no rigid pose.
    """

    intrinsics: np.ndarray
    """(3, 3): focal lengths and principal point in pixels."""
    pose: np.ndarray
    """(4, 4): the camera in the robot base's frame."""
    width: int = 128
    """Image width, pixels."""
    height: int = 128
    """Image height, pixels."""

    def __post_init__(self) -> None:
        """Check what cannot be seen from the pictures."""
        intrinsics = np.asarray(self.intrinsics, np.float64)
        if intrinsics.shape != (3, 3):
            raise PwmGymError(f"intrinsics have shape {intrinsics.shape}; expected (3, 3)")
        if not (np.isfinite(intrinsics).all() and intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0):
            raise PwmGymError(f"focal lengths are {intrinsics[0, 0]} and {intrinsics[1, 1]}; expected positive pixels")
        pose = check_pose("the camera's pose", self.pose)
        if min(self.width, self.height) < 1:
            raise PwmGymError(f"an image of {self.width} x {self.height} pixels; expected at least 1 x 1")
        object.__setattr__(self, "intrinsics", intrinsics)
        object.__setattr__(self, "pose", pose)

    @classmethod
    def looking(
        cls,
        eye: tuple[float, float, float],
        target: tuple[float, float, float],
        fov: float = 60.0,
        width: int = 128,
        height: int = 128,
    ) -> DepthCamera:
        """Camera at ``eye`` that looks at ``target`` (metres, base frame), upright, with a vertical field of view.

        Args:
            eye: its position.
            target: what is at the image's centre.
            fov: vertical field of view, degrees.
            width: pixels.
            height: pixels.
        """
        forward = np.subtract(target, eye).astype(np.float64)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        if np.linalg.norm(right) < 1e-9:
            right = np.array([0.0, -1.0, 0.0])  # straight down or up: the base's x is up in the image
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
        pose[:3, 3] = eye
        focal = 0.5 * height / np.tan(0.5 * np.deg2rad(fov))
        intrinsics = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
        return cls(intrinsics, pose, width, height)

    def resize(self, factor: int) -> DepthCamera:
        """The same view with ``factor`` times as many pixels across and down."""
        intrinsics = self.intrinsics.copy()
        intrinsics[:2] *= factor
        intrinsics[:2, 2] += 0.5 * (factor - 1)  # pixels' centres have whole coordinates
        return DepthCamera(intrinsics, self.pose, factor * self.width, factor * self.height)

    def rays(self) -> np.ndarray:
        """Direction (H, W, 3) of each pixel's ray in the base's frame; its component along the line of sight is 1."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        pixels = np.stack([u, v, np.ones_like(u)], -1).astype(np.float64)
        return pixels @ np.linalg.inv(self.intrinsics).T @ self.pose[:3, :3].T

    def back_project(self, depth: np.ndarray) -> np.ndarray:
        """Points (H, W, 3) in the base's frame of a depth image (H, W) in metres (distance along the line of sight).

        Raises:
            PwmGymError: the image has another size.
        """
        if depth.shape != (self.height, self.width):
            raise PwmGymError(f"depth has shape {depth.shape}; expected ({self.height}, {self.width})")
        return self.pose[:3, 3] + self.rays() * np.asarray(depth, np.float64)[..., None]

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixel u, v and depth (..., 3) of points (..., 3) in the base's frame; u and v mean nothing behind it."""
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        depth = local[..., 2]
        image = local @ self.intrinsics.T
        scale = np.where(np.abs(depth) > 1e-12, depth, 1e-12)
        return np.concatenate([image[..., :2] / scale[..., None], depth[..., None]], -1)


def check_pose(name: str, pose: np.ndarray) -> np.ndarray:
    """A rigid pose (4, 4) as float64; errors call it ``name``.

    Raises:
        PwmGymError: another shape, or no rotation.
    """
    array = np.asarray(pose, np.float64)
    if array.shape != (4, 4):
        raise PwmGymError(f"{name} has shape {array.shape}; expected (4, 4)")
    rotation = array[:3, :3]
    gap = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not (np.isfinite(array).all() and gap < 1e-3 and np.linalg.det(rotation) > 0):
        raise PwmGymError(f"{name} is not rigid: its rotation is off by {gap:.3g}")
    return array
