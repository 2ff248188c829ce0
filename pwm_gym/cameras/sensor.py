"""What a stereo depth camera makes of an ideal depth image: noise, steps, flying pixels and holes.

A stereo camera measures disparity, the shift of a point between its two images, and depth is ``focal * baseline /
disparity``. An error of the disparity that is the same everywhere is thus an error of the depth that grows with its
square (Gallup et al., "Variable Baseline/Resolution Stereo", CVPR 2008). All errors here are made in disparity, in
pixels of the real camera's image, so they do not depend on the size of the image that is simulated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.special import ndtr

from pwm_gym.cameras.camera import DepthCamera
from pwm_gym.errors import PwmGymError, look_up

__all__ = ["SENSORS", "SensorModel", "get_sensor", "surface_normals"]

# Intel RealSense D455. Data sheet: baseline 95 mm, horizontal field of view of the depth 87 degrees, recommended range
# up to 6 m, disparities of at most 126 pixels. Its makers recommend images of 848 x 480 (librealsense issue 9241).
_BASELINE = 0.095
_FOCAL = 0.5 * 848 / np.tan(0.5 * np.deg2rad(87.0))
_CLOSEST = _FOCAL * _BASELINE / 126


@dataclass(frozen=True)
class SensorModel:
    """Errors of a stereo depth camera; without arguments it makes none.

    Pixels in the fields are those of the real camera's image, which ``focal`` belongs to. The real camera's left image
    is taken to be where the simulated camera is; blind zones of the lens and wrong matches are left out.

    Raises:
        PwmGymError: a share outside 0 to 1, a negative size, or an empty range.
    """

    focal: float = _FOCAL
    """Focal length of the real camera, pixels."""
    baseline: float = _BASELINE
    """Distance between its two lenses, metres."""
    subpixel: float = 0.0
    """Standard deviation of the disparity's error, pixels. At a depth z it is ``z**2 * subpixel / (focal * baseline)``
    metres."""
    step: float = 0.0
    """Smallest difference between two disparities, pixels; 0 for none."""
    window: float = 0.0
    """Standard deviation of the Gaussian that smooths errors and holes as a matching window does, pixels."""
    flying: float = 0.0
    """Share of the pixels at depth edges whose disparity lies between the two surfaces."""
    edge: float = 3.0
    """How far from a depth edge pixels may fly, pixels; at least one of the simulated image."""
    jump: float = 1.0
    """Disparity jump that makes a depth edge, pixels."""
    grazing: tuple[float, float] = (90.0, 90.0)
    """Angle between a surface's normal and the line of sight from which pixels are lost, and that at which all are,
    degrees."""
    dropout: float = 0.0
    """Share of all pixels that are lost at random."""
    shadow: bool = False
    """Whether pixels are lost that only the left lens sees: a dark rim left of whatever stands in front."""
    near: float = 0.0
    """Smallest depth that is measured, metres."""
    far: float = np.inf
    """Largest depth that is measured, metres."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("flying", "dropout"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise PwmGymError(f"{name} is {getattr(self, name)}; expected a share from 0 to 1")
        for name in ("subpixel", "step", "window", "edge", "jump", "near"):
            if not getattr(self, name) >= 0.0:
                raise PwmGymError(f"{name} is {getattr(self, name)}; expected 0 or more")
        if not (self.focal > 0.0 and self.baseline > 0.0):
            raise PwmGymError(f"focal is {self.focal} and baseline {self.baseline}; expected positive numbers")
        if not self.near < self.far:
            raise PwmGymError(f"the range is {self.near} to {self.far} metres; expected near below far")

    def apply(self, depth: np.ndarray, camera: DepthCamera, rng: np.random.Generator) -> np.ndarray:
        """The depth image (H, W) that the sensor gives, float32 metres; 0 where it measures nothing.

        Args:
            depth: ideal depth (H, W), metres along the line of sight; 0, negative or not finite where there is nothing.
            camera: took it.
            rng: decides all errors; the same state gives the same image.

        Raises:
            PwmGymError: the image has another size than the camera's.
        """
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0.0).astype(np.float64)
        scale = camera.intrinsics[0, 0] / self.focal  # simulated pixels in one of the real camera
        gain = self.focal * self.baseline
        ideal = _inverse(depth, gain)
        lost = ndtr(_field(depth.shape, self.window * scale, rng)) < self._chance(depth, camera)
        if self.shadow:
            lost |= _shadow(ideal, scale)
        disparity = self._fly(ideal, scale, rng) + self.subpixel * _field(depth.shape, self.window * scale, rng)
        if self.step > 0:
            disparity = self.step * np.round(disparity / self.step)
        measured = _inverse(disparity, gain)
        valid = (depth > 0) & ~lost & (measured >= self.near) & (measured <= self.far)
        return np.where(valid, measured, 0.0).astype(np.float32)

    def _chance(self, depth: np.ndarray, camera: DepthCamera) -> np.ndarray:
        """Probability (H, W) that a pixel is lost at random or because its surface is seen at a grazing angle."""
        rays = camera.rays()
        normals = surface_normals(depth, camera)
        cosine = np.abs(np.einsum("hwc,hwc->hw", normals, rays)) / np.sqrt(np.einsum("hwc,hwc->hw", rays, rays))
        known = normals.any(-1)
        angle = np.rad2deg(np.arccos(np.where(known, np.minimum(cosine, 1.0), 1.0)))
        start, end = self.grazing
        grazing = np.clip((angle - start) / max(end - start, 1e-9), 0.0, 1.0)
        return 1.0 - (1.0 - self.dropout) * (1.0 - grazing)

    def _fly(self, disparity: np.ndarray, scale: float, rng: np.random.Generator) -> np.ndarray:
        """Disparity (H, W) in which some pixels at depth edges are moved towards the surface on the other side."""
        size = 2 * max(1, round(self.edge * scale)) + 1
        front = ndimage.maximum_filter(disparity, size)
        back = ndimage.minimum_filter(np.where(disparity > 0, disparity, np.inf), size)
        # Disparity is linear in the image on a plane, so that this is 0 there however the plane is slanted.
        with np.errstate(invalid="ignore"):
            bend = np.abs(front + back - 2.0 * disparity)
        chosen = (disparity > 0) & (bend > self.jump) & (rng.random(disparity.shape) < self.flying)
        weight = rng.random(disparity.shape)
        return np.where(chosen, weight * front + (1.0 - weight) * np.where(chosen, back, 0.0), disparity)


def surface_normals(depth: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """Unit normals (H, W, 3) of a depth image in the base's frame, towards the camera; zeros where they are unknown.

    Each pixel is compared with those neighbours that are nearer to it in depth, so that a depth edge does not tilt the
    normals beside it; those of a plane are exact.

    Args:
        depth: (H, W) metres; 0 where there is nothing.
        camera: took it.

    Raises:
        PwmGymError: the image has another size than the camera's.
    """
    if depth.shape != (camera.height, camera.width):
        raise PwmGymError(f"depth has shape {depth.shape}; expected ({camera.height}, {camera.width})")
    # On a plane normal @ point = 1, a point is depth * inv(K) @ pixel, and so 1 / depth = normal @ inv(K) @ pixel is
    # linear in the pixel: its slopes give the normal.
    inverse = np.divide(1.0, depth, out=np.full(depth.shape, np.nan), where=depth > 0)
    across, down = _slope(inverse), _slope(inverse.T).T
    v, u = np.ogrid[: camera.height, : camera.width]
    slopes = np.stack([across, down, inverse - across * u - down * v], -1)  # (H, W, 3)
    normals = slopes @ -(camera.intrinsics @ camera.pose[:3, :3].T)
    length = np.sqrt(np.einsum("hwc,hwc->hw", normals, normals))
    return np.nan_to_num(normals / length[..., None])


def get_sensor(name: str) -> SensorModel:
    """The sensor model of that name.

    Raises:
        UnknownNameError: :data:`SENSORS` does not hold it.
    """
    return look_up("sensor", name, SENSORS)


def _slope(values: np.ndarray) -> np.ndarray:
    """Step (H, W) to the next column or from the one before, whichever is smaller; NaN where both are unknown."""
    step = np.diff(values, axis=1)
    ahead = np.pad(step, ((0, 0), (0, 1)), constant_values=np.nan)
    behind = np.pad(step, ((0, 0), (1, 0)), constant_values=np.nan)
    return np.where((np.abs(ahead) <= np.abs(behind)) | np.isnan(behind), ahead, behind)


def _inverse(values: np.ndarray, gain: float) -> np.ndarray:
    """Disparity of depth or depth of disparity; 0 where there is none."""
    return np.divide(gain, values, out=np.zeros_like(values), where=values > 0)


def _field(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Gaussian noise of unit variance, correlated over ``sigma`` pixels."""
    noise = rng.standard_normal(shape)
    if sigma == 0.0:
        return noise
    impulse = np.zeros(2 * int(4.0 * sigma + 0.5) + 1)
    impulse[len(impulse) // 2] = 1.0
    kernel = ndimage.gaussian_filter1d(impulse, sigma)
    return ndimage.gaussian_filter(noise, sigma, mode="wrap") / (kernel**2).sum()


def _shadow(disparity: np.ndarray, scale: float) -> np.ndarray:
    """Pixels (H, W) that something further right in the image hides from the right lens."""
    columns = np.arange(disparity.shape[1]) / scale
    right = np.where(disparity > 0, columns - disparity, np.inf)  # where the right image has them
    nearest = np.minimum.accumulate(right[:, ::-1], axis=1)[:, ::-1]
    return right > np.concatenate([nearest[:, 1:], np.full((len(right), 1), np.inf)], axis=1)


SENSORS: dict[str, SensorModel] = {
    "ideal": SensorModel(),
    # 0.08 pixels is what the makers recommend for its error (librealsense issue 3904); disparities of Intel's cameras
    # have five fractional bits (Keselman et al., "Intel RealSense Stereoscopic Depth Cameras", CVPRW 2017, section
    # 4.2.6). The window, the flying pixels, the grazing angles and the dropout are our choice: nothing is published.
    "d455": SensorModel(
        subpixel=0.08,
        step=1 / 32,
        window=2.0,
        flying=0.5,
        grazing=(70.0, 88.0),
        dropout=0.01,
        shadow=True,
        near=_CLOSEST,
        far=6.0,
    ),
}
"""Sensor models by name: ``ideal`` makes no error, ``d455`` is the Intel RealSense D455."""
