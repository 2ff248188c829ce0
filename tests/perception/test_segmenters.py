import numpy as np
import pytest
import trimesh

from pwm_gym.cameras import DepthCamera, RayCaster
from pwm_gym.errors import PwmGymError
from pwm_gym.perception import Frame, HeightGate, IdSegmenter, MaskSegmenter, Segmenter
from pwm_gym.scene import Layout

LAYOUT = Layout.build([("ball", 200), ("box", 200)])
CAMERA = DepthCamera.looking((0.5, -0.3, 0.5), (0.0, 0.0, 0.0), fov=50.0, width=96, height=64)


@pytest.fixture(scope="module")
def frame() -> Frame:
    """A ball of 5 cm on the table and a box of 4 cm, a quarter of a metre above it."""
    meshes = {"ball": trimesh.creation.icosphere(3, 0.05), "box": trimesh.creation.box((0.04, 0.04, 0.04))}
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = [[0.0, 0.0, 0.05], [-0.1, 0.1, 0.25]]
    view = RayCaster(meshes, LAYOUT).view(CAMERA, poses)
    return Frame(None, view.depth, CAMERA, view.segmentation)


def heights(frame, mask):
    return CAMERA.back_project(frame.depth)[mask][:, 2]


def test_ids_are_the_layouts_indices(frame):
    masks = IdSegmenter(LAYOUT)(frame)
    assert list(masks) == ["ball", "box"]
    assert all(mask.dtype == bool and mask.shape == (64, 96) for mask in masks.values())
    assert heights(frame, masks["ball"]).max() < 0.11 and heights(frame, masks["box"]).min() > 0.22


def test_an_entity_out_of_sight_is_left_out(frame):
    hidden = np.where(frame.segmentation == 1, -1, frame.segmentation)
    assert list(IdSegmenter(LAYOUT)(Frame(None, frame.depth, CAMERA, hidden))) == ["ball"]


def test_ids_that_cannot_be_read_are_named(frame):
    with pytest.raises(PwmGymError, match="no segmentation"):
        IdSegmenter(LAYOUT)(Frame(None, frame.depth, CAMERA))
    with pytest.raises(PwmGymError, match="id 1 is no entity; the layout has 1"):
        IdSegmenter(Layout.build([("ball", 10)]))(frame)


def test_masks_are_given_drawn_by_a_function_or_recorded(frame):
    ball = frame.segmentation == 0
    given = {"ball": ball, "box": np.zeros_like(ball)}
    recorded = Frame(None, frame.depth, CAMERA, masks=given)
    for segment in (MaskSegmenter(given), MaskSegmenter(lambda f: {"ball": f.segmentation == 0})):
        masks = segment(frame)
        assert isinstance(segment, Segmenter) and list(masks) == ["ball"]
        np.testing.assert_array_equal(masks["ball"], ball)
    assert list(MaskSegmenter()(recorded)) == ["ball"]


def test_masks_that_do_not_fit_are_named(frame):
    with pytest.raises(PwmGymError, match=r"mask of 'ball' has shape \(2, 2\)"):
        MaskSegmenter({"ball": np.ones((2, 2), bool)})(frame)
    with pytest.raises(PwmGymError, match="mask of 'ball' has type int64"):
        MaskSegmenter(lambda f: {"ball": np.ones((64, 96), int)})(frame)
    with pytest.raises(PwmGymError, match="masks are a NoneType"):
        MaskSegmenter(lambda f: None)(frame)
    with pytest.raises(PwmGymError, match="the frame has no masks"):
        MaskSegmenter()(frame)


def test_the_gate_keeps_objects_and_drops_phantoms(frame):
    table = frame.segmentation == -1
    found = {"ball": frame.segmentation == 0, "ghost": table, "box": frame.segmentation == 1}
    masks = HeightGate(MaskSegmenter(found))(frame)
    assert list(masks) == ["ball", "box"]
    np.testing.assert_array_equal(masks["box"], found["box"])
    low = HeightGate(MaskSegmenter(found), high=0.2)(frame)
    assert list(low) == ["ball"]
    assert list(HeightGate(MaskSegmenter(found), low=-0.01)(frame)) == ["ball", "ghost", "box"]


def test_the_gate_trims_what_spills_onto_the_table(frame):
    ball = frame.segmentation == 0
    spilt = ball.copy()
    spilt[:, :-1] |= ball[:, 1:]  # one pixel of the table on the left
    gated = HeightGate(MaskSegmenter({"ball": spilt}), low=0.005)(frame)["ball"]
    assert heights(frame, spilt).min() < 0.001 and heights(frame, gated).min() >= 0.005
    assert gated.sum() > 0.9 * ball.sum()


def test_a_mask_that_is_mostly_table_goes_whole(frame):
    ball = frame.segmentation == 0
    rows, columns = np.nonzero(frame.segmentation == -1)
    mixed = ball.copy()
    mixed[rows[: 3 * ball.sum()], columns[: 3 * ball.sum()]] = True  # a quarter of it is the ball
    assert HeightGate(MaskSegmenter({"ball": mixed}))(frame) == {}
    kept = HeightGate(MaskSegmenter({"ball": mixed}), share=0.2)(frame)["ball"]
    assert kept.any() and not (kept & ~ball).any()


def test_pixels_without_depth_leave_the_mask(frame):
    depth = frame.depth.copy()
    rows, columns = np.nonzero(frame.segmentation == 0)
    depth[rows[::2], columns[::2]] = np.nan
    depth[rows[1::4], columns[1::4]] = 0.0
    masks = HeightGate(IdSegmenter(LAYOUT), low=0.0)(Frame(None, depth, CAMERA, frame.segmentation))
    assert masks["ball"].any() and (depth[masks["ball"]] > 0).all()
    blind = Frame(None, np.zeros_like(depth), CAMERA, frame.segmentation)
    assert HeightGate(IdSegmenter(LAYOUT))(blind) == {}


def test_gates_that_cannot_be_are_refused():
    with pytest.raises(PwmGymError, match=r"low=0.5 and high=0.1"):
        HeightGate(IdSegmenter(LAYOUT), low=0.5, high=0.1)
    with pytest.raises(PwmGymError, match="share=2"):
        HeightGate(IdSegmenter(LAYOUT), share=2)
