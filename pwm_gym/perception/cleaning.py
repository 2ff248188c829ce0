"""From a measured depth image and an object's mask to clean points of its visible surface.

Depth cameras err most at an object's outline: pixels there mix the object with what stands behind it, and masks spill
over by a pixel or two. The steps of :func:`clean`, in this order: leave out depth edges, erode the mask, filter the
depth by its median, back-project, drop outliers, drop what hangs apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pwm_gym.cameras.camera import DepthCamera
from pwm_gym.cameras.sensor import surface_normals
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import spacing

__all__ = ["Cleaning", "check_metres", "clean", "clusters", "depth_edges", "inliers", "median_depth"]

_FEWEST = 32  # points: fewer say nothing about an object's shape
_METRES = 20.0  # metres: indoor depth cameras see less far


@dataclass(frozen=True)
class Cleaning:
    """How depth is cleaned; 0 in ``edge_jump``, ``erosion``, ``median``, ``neighbours`` or ``cluster`` skips that step.

    Raises:
        PwmGymError: a negative number, or an even width of the median's window.
    """

    edge_jump: float = 0.03
    """How much farther than the nearest of its 3 x 3 pixels one must be to lie at a depth edge, as a share of its depth
    (0.03 as in MoGe's masks; the idea as in TAPIP3D's)."""
    edge_angle: float = 30.0
    """Difference of the normals there, degrees, that a depth edge needs too: slanted planes have none. More than MoGe's
    5 degrees, which suit predicted depth, since measured depth is noisy."""
    erosion: int = 1
    """Pixels taken off the mask's outline."""
    inside: float = 0.9
    """Least share of the pixels that the erosion must leave; otherwise it is left out: a small object's outline is a
    large part of it, and without it the object looks smaller."""
    sharp: float = 0.4
    """Least share of the mask's measured pixels that edges must leave; otherwise they stay, as of thin objects, which
    are all edge."""
    median: int = 3
    """Width of the median filter's window, pixels (odd)."""
    neighbours: int = 12
    """Nearest neighbours whose mean distance tells whether a point is an outlier."""
    spread: float = 2.5
    """Times the median of that distance from which a point is one."""
    reach: float = 3.0
    """Times the median distance to the 4 nearest neighbours up to which points hang together."""
    cluster: float = 0.05
    """Share of the largest cluster's points that another one needs to be kept; 1 keeps only the largest. An occluder in
    front of an object cuts its visible surface in two, so that smaller parts may be true."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in vars(self).items():
            if not value >= 0:
                raise PwmGymError(f"{name} is {value}; expected 0 or more")
        if self.median and self.median % 2 == 0:
            raise PwmGymError(f"median is {self.median}; expected an odd number of pixels, or 0")


def clean(depth: np.ndarray, mask: np.ndarray, camera: DepthCamera, config: Cleaning | None = None) -> np.ndarray:
    """Points (m, 3) of an object's visible surface in the base's frame, float32, metres; m is at least 32.

    Args:
        depth: measured depth (H, W), metres; 0, negative, NaN and infinite values count as no measurement.
        mask: the object's pixels (H, W), bool; of other types, those that are not 0.
        camera: took both.
        config: how; the defaults if None.

    Raises:
        PwmGymError: depth or mask has another size than the camera's image, the mask is empty, no pixel of it is
            measured, the depth is evidently in millimetres, or fewer than 32 points are left.
    """
    config = config or Cleaning()
    depth, mask = _checked(depth, mask, camera)
    pixels = _reliable(depth, mask, camera, config)
    if config.median:
        depth = median_depth(depth, pixels, config.median)
    points = camera.back_project(depth)[pixels]
    if config.neighbours:
        points = points[inliers(points, config.neighbours, config.spread)]
    if config.cluster:
        points = points[clusters(points, config.reach, config.cluster)]
    if len(points) < _FEWEST:
        raise PwmGymError(
            f"{len(points)} points are left after cleaning, of {mask.sum()} pixels in the mask; expected at least "
            f"{_FEWEST}"
        )
    return points.astype(np.float32)


def depth_edges(depth: np.ndarray, camera: DepthCamera, jump: float, angle: float) -> np.ndarray:
    """Pixels (H, W) on the far side of a jump in depth, where the surface normal jumps too, within 3 x 3 pixels.

    The near side is left alone: flying pixels and what a mask takes from the background lie behind the object, and thin
    objects would be all edge.

    Args:
        depth: (H, W) metres; 0 where there is nothing.
        camera: took it.
        jump: difference in depth to the nearest of the pixels, as a share of the pixel's own.
        angle: difference of the normals, degrees.
    """
    known = depth > 0
    nearest = ndimage.minimum_filter(np.where(known, depth, np.inf), 3)
    jumps = known & (depth - np.where(known, nearest, 0.0) > jump * depth)
    normals = surface_normals(depth, camera)
    size = (3, 3, 1)
    spread = ndimage.maximum_filter(normals, size) - ndimage.minimum_filter(normals, size)
    chord = 2.0 * np.sin(0.5 * np.deg2rad(angle))
    return jumps & ((spread * spread).sum(-1) > chord * chord)


def median_depth(depth: np.ndarray, mask: np.ndarray, size: int) -> np.ndarray:
    """Depth (H, W) in which each measured pixel of the mask is the median of those within ``size`` x ``size`` pixels.

    Pixels outside the mask neither change nor count; those without a measurement get none. A pixel of the window counts
    only if the opposite one does: half a window would bend slanted surfaces at the mask's outline.

    Args:
        depth: (H, W) metres; 0 where there is nothing.
        mask: (H, W) bool.
        size: the window's width, pixels (odd).
    """
    chosen = mask & (depth > 0)
    # scipy's median filter knows no mask. NaNs are sorted last, behind the values that count.
    padded = np.pad(np.where(chosen, depth, np.nan), size // 2, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size))[chosen].reshape(-1, size * size)
    windows = np.sort(np.where(np.isnan(windows[:, ::-1]), np.nan, windows), axis=1)
    count = np.isfinite(windows).sum(1)
    rows = np.arange(len(windows))
    result = np.array(depth, np.float64)
    result[chosen] = 0.5 * (windows[rows, (count - 1) // 2] + windows[rows, count // 2])
    return result


def inliers(points: np.ndarray, neighbours: int, spread: float) -> np.ndarray:
    """Which points (m,) lie about as close to their neighbours as most do (statistical outlier removal).

    The usual bound is the mean distance plus some standard deviations; the median is not moved by the outliers.

    Args:
        points: (m, 3) metres.
        neighbours: how many of the nearest count.
        spread: times the median of the mean distances to them; points above it are outliers.
    """
    distance = spacing(points, neighbours)
    return distance <= spread * np.median(distance) if len(points) else np.zeros(0, bool)


def clusters(points: np.ndarray, reach: float, share: float) -> np.ndarray:
    """Which points (m,) belong to the largest cluster or to one that is not much smaller.

    Args:
        points: (m, 3) metres.
        reach: times the median distance to the 4 nearest neighbours up to which points hang together.
        share: of the largest cluster's points that another needs.
    """
    if len(points) < 2:
        return np.ones(len(points), bool)
    radius = reach * float(np.median(spacing(points, 4)))
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), (len(points), len(points)))
    _, label = connected_components(graph, directed=False)
    count = np.bincount(label)
    return count[label] >= share * count.max()


def check_metres(depth: np.ndarray) -> None:
    """Refuse depths (m,) that are evidently in millimetres.

    Raises:
        PwmGymError: their median is more than 20.
    """
    if len(depth) and (middle := float(np.median(depth))) > _METRES:
        raise PwmGymError(f"the median depth is {middle:.4g} m: this looks like millimetres; divide by 1000")


def _checked(depth: np.ndarray, mask: np.ndarray, camera: DepthCamera) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H, W) float64 with 0 for no measurement, and mask (H, W) bool; raises what :func:`clean` says."""
    shape = (camera.height, camera.width)
    for name, image in (("depth", depth), ("mask", mask)):
        if np.shape(image) != shape:
            raise PwmGymError(f"the {name} has shape {np.shape(image)}; expected the camera's {shape}")
    depth, mask = np.asarray(depth, np.float64), np.asarray(mask, bool)
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0.0)
    if not mask.any():
        raise PwmGymError("the mask has no pixel; expected those of one object")
    if not depth[mask].any():
        raise PwmGymError(f"none of the mask's {mask.sum()} pixels has a depth; expected finite positive metres")
    check_metres(depth[depth > 0])
    return depth, mask


def _reliable(depth: np.ndarray, mask: np.ndarray, camera: DepthCamera, config: Cleaning) -> np.ndarray:
    """Measured pixels (H, W) of the mask off its outline and off depth edges, as far as enough are left."""
    measured = mask & (depth > 0)
    sharp = measured
    if config.edge_jump:
        sharp = measured & ~depth_edges(depth, camera, config.edge_jump, config.edge_angle)
    inner = sharp
    if config.erosion:
        inner = sharp & ndimage.binary_erosion(mask, iterations=config.erosion, border_value=1)
    if inner.sum() >= config.inside * sharp.sum() and inner.any():
        return inner
    return sharp if sharp.sum() >= config.sharp * measured.sum() else measured
