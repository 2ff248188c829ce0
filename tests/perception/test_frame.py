import json

import numpy as np
import pytest
from PIL import Image

from pwm_gym.cameras import DepthCamera
from pwm_gym.errors import PwmGymError
from pwm_gym.perception import Frame, load_frames

CAMERA = DepthCamera.looking((0.6, 0.0, 0.5), (0.0, 0.0, 0.0), width=8, height=6)


def arrays(seed=0):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.4, 0.9, (6, 8)).astype(np.float32)
    depth[0, :2] = [0.0, np.nan]
    return {"colour": rng.integers(0, 256, (6, 8, 3)).astype(np.uint8), "depth": depth}


def same(one, other):
    for name in ("colour", "depth", "segmentation", "joints", "links"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.camera.pose, other.camera.pose)
    np.testing.assert_array_equal(one.camera.intrinsics, other.camera.intrinsics)
    assert (one.camera.width, one.camera.height) == (other.camera.width, other.camera.height)
    assert one.masks is None if other.masks is None else one.masks.keys() == other.masks.keys()
    for name, mask in (one.masks or {}).items():
        np.testing.assert_array_equal(mask, other.masks[name])


def write_recording(folder, count=11, depth="png"):
    """Frames 0, 1, ...: depth (0.5 + k / 100) metres, colour (k, k, k); the cube is seen in all but frame 0."""
    told = {"intrinsics": CAMERA.intrinsics.tolist(), "pose": CAMERA.pose.tolist(), "width": 8, "height": 6}
    (folder / "camera.json").write_text(json.dumps(told))
    cube = np.zeros((6, 8), np.uint8)
    cube[2:4, 2:5] = 255
    for k in range(count):
        if depth == "png":
            Image.fromarray(np.full((6, 8), 500 + 10 * k, np.uint16)).save(folder / f"depth-{k}.png")
        else:
            np.save(folder / f"depth-{k}.npy", np.full((6, 8), 0.5 + k / 100))
        Image.fromarray(np.full((6, 8, 3), k, np.uint8)).save(folder / f"colour-{k}.png")
        if k:
            Image.fromarray(cube).save(folder / f"mask-red-cube-{k}.png")
    np.save(folder / "joints.npy", np.arange(count)[:, None] * np.ones(9))


def test_pixels_without_a_measurement_are_not_valid():
    frame = Frame(**arrays(), camera=CAMERA)
    assert frame.depth.dtype == np.float32
    assert not frame.valid[0, :2].any() and frame.valid.sum() == 46


@pytest.mark.parametrize(
    "extras",
    [
        {"colour": None},
        {"masks": {}},
        {
            "segmentation": np.arange(48, dtype=np.int16).reshape(6, 8) - 2,
            "joints": np.linspace(0, 1, 9),
            "links": np.linspace(-1, 1, 21).reshape(3, 7),
            "masks": {"cube_a": np.eye(6, 8, dtype=bool), "a cup/lid": np.ones((6, 8), bool)},
        },
    ],
)
def test_a_frame_survives_its_file(tmp_path, extras):
    frame = Frame(**{**arrays(), **extras}, camera=CAMERA)
    frame.save(tmp_path / "frame.npz")
    same(Frame.load(tmp_path / "frame.npz"), frame)
    (again,) = load_frames(tmp_path / "frame.npz")
    same(again, frame)


def test_a_folder_of_files_is_read_in_the_order_of_its_numbers(tmp_path):
    for number in (10, 9, 100):
        Frame(None, np.full((6, 8), number / 100), CAMERA).save(tmp_path / f"view-{number}.npz")
    assert [round(float(f.depth[0, 0]), 2) for f in load_frames(tmp_path)] == [0.09, 0.1, 1.0]


@pytest.mark.parametrize("depth", ["png", "npy"])
def test_recorded_images_become_frames(tmp_path, depth):
    write_recording(tmp_path, depth=depth)
    frames = load_frames(tmp_path)
    assert len(frames) == 11
    for k, frame in enumerate(frames):
        np.testing.assert_allclose(frame.depth, 0.5 + k / 100, rtol=1e-6)
        assert (frame.colour == k).all() and (frame.joints == k).all() and frame.segmentation is None
        np.testing.assert_array_equal(frame.camera.pose, CAMERA.pose)
    assert frames[0].masks == {}
    assert list(frames[10].masks) == ["red-cube"] and frames[10].masks["red-cube"].sum() == 6


def test_depth_alone_is_a_recording(tmp_path):
    write_recording(tmp_path, 2)
    for file in [*tmp_path.glob("colour-*"), *tmp_path.glob("mask-*"), tmp_path / "joints.npy"]:
        file.unlink()
    frames = load_frames(tmp_path)
    assert len(frames) == 2
    assert all(f.colour is None and f.masks is None and f.joints is None for f in frames)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"colour": np.zeros((3, 4, 3), np.uint8)}, r"colour has \(3, 4\) pixels and depth \(6, 8\).*align"),
        ({"colour": np.zeros((6, 8, 3))}, r"type float64; expected \(H, W, 3\) uint8"),
        ({"colour": np.zeros((6, 8), np.uint8)}, r"colour has shape \(6, 8\)"),
        ({"colour": None, "depth": np.ones((8, 6))}, r"depth has shape \(8, 6\); expected \(6, 8\)"),
        ({"depth": np.full((6, 8), 712, np.uint16)}, "median depth is 712 m: this looks like millimetres"),
        ({"segmentation": np.zeros((6, 7), int)}, r"segmentation has shape \(6, 7\)"),
        ({"segmentation": np.zeros((6, 8))}, r"type float64; expected \(6, 8\) integers"),
        ({"joints": np.array([0.0, np.nan])}, "joints are .*nan"),
        ({"links": np.zeros((3, 6))}, r"links have shape \(3, 6\); expected \(L, 7\) finite values"),
        ({"links": np.full((3, 7), np.nan)}, r"links have shape \(3, 7\); expected \(L, 7\) finite values"),
        ({"masks": {"cube": np.zeros((5, 5), bool)}}, r"mask of 'cube' has shape \(5, 5\)"),
        ({"masks": {"cube": np.zeros((6, 8), np.uint8)}}, "mask of 'cube' has type uint8"),
        ({"masks": [np.zeros((6, 8), bool)]}, "masks are a list"),
    ],
)
def test_arrays_that_do_not_fit_are_named(changes, complaint):
    with pytest.raises(PwmGymError, match=complaint):
        Frame(**{**arrays(), **changes}, camera=CAMERA)


def _edit_camera(folder, **changes):
    told = json.loads((folder / "camera.json").read_text()) | changes
    (folder / "camera.json").write_text(json.dumps({k: v for k, v in told.items() if v is not None}))


BROKEN = {
    "no camera": (lambda f: (f / "camera.json").unlink(), "camera.json describes no camera.*No such file"),
    "half a camera": (lambda f: _edit_camera(f, pose=None, width=None), r"it lacks pose, width\); expected intrinsics"),
    "a bent pose": (lambda f: _edit_camera(f, pose=[[1]]), r"camera's pose has shape \(1, 1\)"),
    "another size": (lambda f: _edit_camera(f, width=9), r"frame 0 of .*depth has shape \(6, 8\); expected \(6, 9\)"),
    "a lost colour": (lambda f: (f / "colour-1.png").unlink(), "2 colour and 3 depth images; without a partner: 1"),
    "a lost depth": (lambda f: (f / "depth-2.png").unlink(), "3 colour and 2 depth images; without a partner: 2"),
    "two depths": (lambda f: np.save(f / "depth-0.npy", np.ones((6, 8))), "depth as png and as npy"),
    "few joints": (lambda f: np.save(f / "joints.npy", np.ones((2, 9))), r"shape \(2, 9\); expected \(3, J\)"),
    "torn joints": (lambda f: (f / "joints.npy").write_bytes(b"\x93NUMPY"), "joints.npy is not an array"),
    "a stray mask": (lambda f: (f / "mask-red-cube-1.png").rename(f / "mask-red-cube-7.png"), "belongs to no depth"),
    "8-bit depth": (
        lambda f: Image.fromarray(np.ones((6, 8), np.uint8)).save(f / "depth-0.png"),
        r"depth-0.png is an image of shape \(6, 8\) and type uint8; expected 16-bit grey",
    ),
    "torn depth": (lambda f: (f / "depth-0.png").write_bytes(b"\x89PNG"), "depth-0.png is not an image"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_recording_says_what_is_wrong(tmp_path, case):
    write_recording(tmp_path, 3)
    damage, complaint = BROKEN[case]
    damage(tmp_path)
    with pytest.raises(PwmGymError, match=complaint):
        load_frames(tmp_path)


def test_what_is_no_frame_is_refused(tmp_path):
    with pytest.raises(PwmGymError, match="holds no frames"):
        load_frames(tmp_path)
    with pytest.raises(PwmGymError, match="nothing does not exist"):
        load_frames(tmp_path / "nothing")
    np.savez(tmp_path / "other.npz", depth=np.ones((6, 8)))
    with pytest.raises(PwmGymError, match=r"other.npz is not a frame file"):
        load_frames(tmp_path)
