import time

import numpy as np
import pytest

from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Layout
from pwm_gym.viewer import BACKGROUND, GOAL, PREDICTED, TRUE, Camera, entity_colors, render, tint

CAMERA = Camera(eye=(1.0, 0.0, 0.1), target=(0.0, 0.0, 0.1), width=64, height=48)
MIDDLE = np.array([0.0, 0.0, 0.1])
RED, BLUE = (255, 0, 0), (0, 0, 255)


def hue(color):
    """Index of the strongest channel."""
    return int(np.argmax(color))


def test_shape_type_and_background():
    image = render(np.zeros((0, 3)), np.zeros((0, 3)), CAMERA, ground=None, background=(10, 20, 30))
    assert image.shape == (48, 64, 3)
    assert image.dtype == np.uint8
    assert (image == (10, 20, 30)).all()


def test_empty_cloud_on_the_table():
    image = render(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), CAMERA, goal=MIDDLE)
    assert image.shape == (48, 64, 3)
    assert hue(image[24, 32]) == 1, "the goal is drawn without points"


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_point_wins(order):
    points = np.array([MIDDLE + np.array([0.1, 0, 0]), MIDDLE - np.array([0.1, 0, 0])])[list(order)]
    colors = np.array([RED, BLUE], np.uint8)[list(order)]
    assert hue(render(points, colors, CAMERA, radius=0.03)[24, 32]) == 0


@pytest.mark.parametrize("supersample", [1, 2, 3])
def test_disc_has_its_perspective_size(supersample):
    black, white = np.zeros(3, np.uint8), (255, 255, 255)
    image = render(MIDDLE[None], black, CAMERA, 0.05, white, ground=None, supersample=supersample)
    covered = (1 - image[..., 2] / 255).sum()
    assert covered == pytest.approx(np.pi * (CAMERA.focal * 0.05) ** 2, rel=0.1)


def test_float_and_integer_colors_agree():
    points = MIDDLE + np.random.default_rng(0).normal(0, 0.03, (50, 3))
    colors = np.random.default_rng(1).integers(0, 256, (50, 3)).astype(np.uint8)
    np.testing.assert_array_equal(render(points, colors, CAMERA), render(points, colors / 255.0, CAMERA))


def test_a_point_behind_the_camera_is_not_drawn():
    image = render(np.array([[2.0, 0.0, 0.1]]), np.array([RED], np.uint8), CAMERA, radius=0.1, ground=None)
    assert (image == BACKGROUND).all()


def test_points_cast_shadows_below_them():
    camera = Camera(eye=(0.5, 0.0, 0.8), target=(0.0, 0.0, 0.0), width=64, height=64)
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (200, 3)) + np.array([0, 0, 0.15])
    empty = render(np.zeros((0, 3)), np.zeros((0, 3)), camera)
    x, y = camera.project(np.zeros((1, 3)))[0, :2].astype(int)
    assert render(points, np.array(RED, np.uint8), camera)[y, x].mean() < empty[y, x].mean() - 10


def test_goal_is_translucent_and_hidden_by_nearer_points():
    colors = np.array([BLUE], np.uint8)
    arguments = {"camera": CAMERA, "radius": 0.03, "ground": None, "goal": MIDDLE, "goal_radius": 0.04}
    in_front = render(MIDDLE[None] + [0.2, 0, 0], colors, **arguments)[24, 32]
    behind = render(MIDDLE[None] - [0.2, 0, 0], colors, **arguments)[24, 32]
    assert in_front[1] < 60, "a point in front of the goal hides it"
    assert behind[1] > in_front[1] + 30, "a point behind it shows through, tinted"
    assert hue(behind) == 2


def test_rendering_is_deterministic_and_does_not_touch_its_input():
    points = MIDDLE + np.random.default_rng(0).normal(0, 0.05, (300, 3))
    before, colors = points.copy(), np.array(TRUE, np.uint8)
    first, second = (render(points, colors, CAMERA, goal=MIDDLE) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(points, before)


def test_extreme_points_are_drawn_without_trouble():
    points = np.array([[0.985, 0, 0.1], [0, 0, -5], [0, 0, 500], [-4000, 0, 0], [0, 3000, 0]], dtype=float)
    assert render(points, np.array(RED, np.uint8), CAMERA).shape == (48, 64, 3)


@pytest.mark.parametrize(
    ("points", "colors", "message"),
    [
        (
            np.array([[np.nan, 0, 0], [0, 0, 0], [0, np.inf, 0]]),
            np.zeros((3, 3)),
            "2 of 3 points are not finite",
        ),
        (np.zeros((3, 2)), np.zeros((3, 3)), r"points has shape \(3, 2\)"),
        (np.zeros((2, 3, 3)), np.zeros((3, 3)), r"expected \(N, 3\)"),
        (np.zeros((3, 3)), np.zeros((4, 3)), r"colors has shape \(4, 3\)"),
    ],
)
def test_bad_input_is_named(points, colors, message):
    with pytest.raises(PwmGymError, match=message):
        render(points, colors, CAMERA)


def test_a_frame_is_fast_enough_for_an_environment():
    camera = Camera(eye=(1.2, -0.7, 0.6), target=(0.6, 0.0, 0.15), fov=28)
    points = np.random.default_rng(0).uniform(-0.08, 0.08, (1200, 3)) + np.array([0.6, 0, 0.15])
    seconds = []
    for _ in range(6):
        start = time.perf_counter()
        render(points, np.array(PREDICTED, np.uint8), camera, goal=MIDDLE, supersample=1)
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 0.15  # about 0.015 on one core; the rest is for busy machines


def test_entities_have_tints_of_one_hue():
    effectors = ("hand", "left_gripper", "right_gripper")
    layout = Layout.build([(n, 2) for n in (*effectors, "cube")], driven=effectors)
    colors = entity_colors(layout, TRUE)
    assert colors.shape == (8, 3)
    assert colors.dtype == np.uint8
    assert (colors[2] == colors[4]).all(), "both fingers look alike"
    assert len(np.unique(colors, axis=0)) == 3
    assert (colors[:, 1] < colors[:, [0, 2]].min(1)).all(), "all are purple"
    assert tint(GOAL, 0.0) == GOAL
