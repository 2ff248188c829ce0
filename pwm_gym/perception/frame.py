"""One RGB-D view with its camera: what a segmenter reads; its file, and folders of recorded images."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from pwm_gym.cameras import DepthCamera
from pwm_gym.errors import PwmGymError
from pwm_gym.files import load_array, load_arrays, save_arrays
from pwm_gym.perception.cleaning import check_metres

__all__ = ["Frame", "check_masks", "load_frames"]

_FORMAT = "pwm_gym.frame"
_CAMERA = ("intrinsics", "pose", "width", "height")
_OPTIONAL = ("colour", "segmentation", "joints", "links")
_MASK = "mask/"  # the prefix of a mask's name in a frame's file


@dataclass(frozen=True)
class _Header:
    """What a frame's file says beside its arrays."""

    format: str
    masks: bool = False


@dataclass(frozen=True, eq=False)
class Frame:
    """One view of an RGB-D camera, colour aligned to depth.

    Raises:
        PwmGymError: arrays whose sizes do not fit each other or the camera, or depth that is in millimetres.
    """

    colour: np.ndarray | None
    """(H, W, 3) uint8, red first; None where the camera has no colour."""
    depth: np.ndarray
    """(H, W) float32, metres along the line of sight; 0 or NaN where nothing was measured."""
    camera: DepthCamera
    """Where it looks from, in the robot base's frame."""
    segmentation: np.ndarray | None = None
    """(H, W) int: a simulator's ids, as in :class:`~pwm_gym.cameras.View`."""
    joints: np.ndarray | None = None
    """(J,): the robot's joint angles (radians) and openings (metres)."""
    links: np.ndarray | None = None
    """(L, 7): the driven links' poses as the robot itself reports them (xyz metres, quaternion wxyz, base frame);
    needed where its kinematics are not known."""
    masks: Mapping[str, np.ndarray] | None = None
    """Entity name to bool (H, W): masks that were recorded with the view."""

    def __post_init__(self) -> None:
        """Check what would otherwise show as a cloud in the wrong place."""
        depth = np.asarray(self.depth, np.float32)
        object.__setattr__(self, "depth", depth)
        self._check_colour()
        shape = (self.camera.height, self.camera.width)
        if depth.shape != shape:
            raise PwmGymError(f"depth has shape {depth.shape}; expected {shape}, the camera's height and width")
        check_metres(depth[self.valid])
        self._check_extras()

    def _check_colour(self) -> None:
        if self.colour is None:
            return
        colour = np.asarray(self.colour)
        if colour.ndim != 3 or colour.shape[2] != 3 or colour.dtype != np.uint8:
            raise PwmGymError(f"colour has shape {colour.shape} and type {colour.dtype}; expected (H, W, 3) uint8")
        if colour.shape[:2] != self.depth.shape:
            raise PwmGymError(
                f"colour has {colour.shape[:2]} pixels and depth {self.depth.shape}; expected one size: align them"
            )
        object.__setattr__(self, "colour", colour)

    def _check_extras(self) -> None:
        if self.segmentation is not None:
            segmentation = np.asarray(self.segmentation)
            if segmentation.shape != self.depth.shape or not np.issubdtype(segmentation.dtype, np.integer):
                found = f"shape {segmentation.shape} and type {segmentation.dtype}"
                raise PwmGymError(f"segmentation has {found}; expected {self.depth.shape} integers")
            object.__setattr__(self, "segmentation", segmentation)
        if self.joints is not None:
            joints = np.asarray(self.joints, np.float64)
            if joints.ndim != 1 or not np.isfinite(joints).all():
                raise PwmGymError(f"joints are {joints}; expected (J,) finite values")
            object.__setattr__(self, "joints", joints)
        if self.links is not None:
            links = np.asarray(self.links, np.float64)
            if links.ndim != 2 or links.shape[1] != 7 or not np.isfinite(links).all():
                raise PwmGymError(f"links have shape {links.shape}; expected (L, 7) finite values")
            object.__setattr__(self, "links", links)
        if self.masks is not None:
            object.__setattr__(self, "masks", check_masks(self.masks, self.depth.shape))

    @property
    def valid(self) -> np.ndarray:
        """Bool (H, W): pixels whose depth was measured."""
        return np.isfinite(self.depth) & (self.depth > 0)

    def save(self, path: str | Path) -> None:
        """Write the frame to an ``.npz`` file (arrays and JSON text, no pickle)."""
        arrays = {k: v for k in _OPTIONAL if (v := getattr(self, k)) is not None}
        arrays |= {"depth": self.depth, "intrinsics": self.camera.intrinsics, "pose": self.camera.pose}
        arrays |= {_MASK + name: mask for name, mask in (self.masks or {}).items()}
        save_arrays(path, arrays, {"format": _FORMAT, "schema": 1, "masks": self.masks is not None})

    @classmethod
    def load(cls, path: str | Path) -> Frame:
        """Read a frame that :meth:`save` wrote.

        Raises:
            PwmGymError: the file is missing, truncated or not a frame.
        """
        arrays, header = load_arrays(path, "is not a frame file", PwmGymError, _FORMAT, _Header, gaps=["depth"])
        if missing := [k for k in ("depth", "intrinsics", "pose") if k not in arrays]:
            raise PwmGymError(f"{path} is not a frame file (it lacks {', '.join(missing)})")
        depth = arrays["depth"]
        if depth.ndim != 2:
            raise PwmGymError(f"{path}: depth has shape {depth.shape}; expected (H, W)")
        camera = DepthCamera(arrays["intrinsics"], arrays["pose"], depth.shape[-1], depth.shape[0])
        masks = {k.removeprefix(_MASK): v for k, v in arrays.items() if k.startswith(_MASK)}
        optional = {k: arrays.get(k) for k in _OPTIONAL}
        return cls(depth=depth, camera=camera, masks=masks if header.masks else None, **optional)


def check_masks(masks: Mapping[str, np.ndarray], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """The same masks as a dict, all of them bool and of an image's ``shape`` (H, W).

    Raises:
        PwmGymError: no mapping, or a mask of another size or type.
    """
    if not isinstance(masks, Mapping):
        raise PwmGymError(f"masks are a {type(masks).__name__}; expected a mapping of entity name to bool (H, W)")
    arrays = {name: np.asarray(mask) for name, mask in masks.items()}
    for name, mask in arrays.items():
        if mask.shape != shape:
            raise PwmGymError(f"the mask of {name!r} has shape {mask.shape}; expected {shape}, the frame's")
        if mask.dtype != np.bool_:
            raise PwmGymError(f"the mask of {name!r} has type {mask.dtype}; expected bool (such as mask > 0)")
    return arrays


def load_frames(path: str | Path) -> list[Frame]:
    """Frames of one ``.npz`` file, of a folder of them, or of a folder of recorded images, in the order of their names.

    Recorded images are ``depth-<k>.png`` (16 bits, millimetres) or ``depth-<k>.npy`` (metres), and where there are any
    ``colour-<k>.png``, ``mask-<entity>-<k>.png`` (not black: the entity; a frame may lack it) and ``joints.npy``
    (T, J). ``camera.json`` holds ``intrinsics`` (3 x 3, pixels), ``pose`` (4 x 4, the camera in the robot base's
    frame, OpenCV's axes), ``width`` and ``height``.

    Raises:
        PwmGymError: nothing is there, a part is missing or unreadable, or the counts do not match.
    """
    path = Path(path)
    if path.is_file():
        return [Frame.load(path)]
    if not path.is_dir():
        raise PwmGymError(f"{path} does not exist; expected an .npz file or a folder of frames")
    saved = _in_order(path.glob("*.npz"))
    return [Frame.load(p) for p in saved] if saved else _recorded(path)


def _recorded(folder: Path) -> list[Frame]:
    depths = _series(folder, "depth", ("png", "npy"))
    if not depths:
        raise PwmGymError(f"{folder} holds no frames; expected *.npz, depth-*.png or depth-*.npy")
    colours = _series(folder, "colour", ("png",))
    if alone := sorted(depths.keys() ^ colours.keys() if colours else ()):
        counts = f"{len(colours)} colour and {len(depths)} depth images"
        raise PwmGymError(f"{folder} has {counts}; without a partner: {', '.join(alone)}")
    camera, masks = _camera(folder / "camera.json"), _masks(folder, list(depths))
    joints = _joints(folder / "joints.npy", len(depths))
    frames = []
    for index, (key, file) in enumerate(depths.items()):
        colour = _read_image(colours[key], "RGB") if colours else None
        angles = None if joints is None else joints[index]
        own = None if masks is None else masks[key]
        try:
            frames.append(Frame(colour, _read_depth(file), camera, joints=angles, masks=own))
        except PwmGymError as error:
            raise PwmGymError(f"frame {key} of {folder}: {error}") from error
    return frames


def _in_order(files: Iterable[Path]) -> list[Path]:
    """Files in the order of the numbers in their names: 9 before 10."""
    return sorted(files, key=lambda file: [int(t) if t.isdecimal() else t for t in re.split(r"(\d+)", file.name)])


def _series(folder: Path, kind: str, endings: tuple[str, ...]) -> dict[str, Path]:
    """Files ``<kind>-<k>.<ending>`` by k, in order."""
    found = {ending: list(folder.glob(f"{kind}-*.{ending}")) for ending in endings}
    used = [ending for ending, files in found.items() if files]
    if len(used) > 1:
        raise PwmGymError(f"{folder} has {kind} as {' and as '.join(used)}; expected one of them")
    return {file.stem.removeprefix(f"{kind}-"): file for file in _in_order(found[used[0]] if used else ())}


def _camera(path: Path) -> DepthCamera:
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        if missing := [key for key in _CAMERA if key not in told]:
            raise PwmGymError(f"it lacks {', '.join(missing)}")
        intrinsics, pose = np.array(told["intrinsics"], float), np.array(told["pose"], float)
        return DepthCamera(intrinsics, pose, int(told["width"]), int(told["height"]))
    except (OSError, TypeError, ValueError) as cause:
        expected = "intrinsics (3 x 3, pixels), pose (4 x 4, the camera in the base's frame), width and height"
        raise PwmGymError(f"{path} describes no camera ({cause}); expected {expected}") from cause


def _joints(path: Path, count: int) -> np.ndarray | None:
    if not path.exists():
        return None
    joints = load_array(path, PwmGymError)
    if joints.ndim != 2 or len(joints) != count:
        raise PwmGymError(f"{path} has shape {joints.shape}; expected ({count}, J), a row for each depth image")
    return joints


def _masks(folder: Path, keys: list[str]) -> dict[str, dict[str, np.ndarray]] | None:
    """Masks by frame, then by entity; None without any."""
    files = _in_order(folder.glob("mask-*.png"))
    masks: dict[str, dict[str, np.ndarray]] = {key: {} for key in keys}
    for file in files:
        name = file.stem.removeprefix("mask-")
        key = max((k for k in keys if name.endswith(f"-{k}")), key=len, default=None)
        if key is None:
            raise PwmGymError(f"{file} belongs to no depth image; expected mask-<entity>-<k>.png of a depth-<k>")
        masks[key][name.removesuffix(f"-{key}")] = _read_image(file, "L") > 0
    return masks if files else None


def _read_depth(path: Path) -> np.ndarray:
    """Depth in metres; a 16-bit image holds millimetres."""
    if path.suffix == ".npy":
        return load_array(path, PwmGymError)
    depth = _read_image(path)
    if depth.dtype.itemsize < 2 or depth.ndim != 2:
        raise PwmGymError(f"{path} is an image of shape {depth.shape} and type {depth.dtype}; expected 16-bit grey")
    return depth.astype(np.float32) / 1000


def _read_image(path: Path, mode: str | None = None) -> np.ndarray:
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert(mode) if mode else image)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as cause:  # a broken PNG is a SyntaxError
        raise PwmGymError(f"{path} is not an image ({cause})") from cause
