import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pwm_gym.assets import generated_pieces
from pwm_gym.assets.trials import YcbTrials
from pwm_gym.errors import UnknownNameError
from pwm_gym.skills import PickObject, find_grasps

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
GOAL = np.array([0.6, 0.1, 0.2])


@pytest.fixture(scope="module")
def expert():
    return PickObject(find_grasps(generated_pieces("shape_bar"), count=4))


def scene(tool, width, body=(0.6, 0.0, 0.015)):
    """Poses (4, 7) of a hand that points down, fingers ``width`` apart, and the bar."""
    hand = np.array([*tool, *DOWN]) + [0, 0, 0.1034, 0, 0, 0, 0]
    fingers = [hand + [0, side * width / 2, -0.0584, 0, 0, 0, 0] for side in (-1, 1)]  # the tool's y is the world's -y
    return np.stack([hand, *fingers, np.array([*body, 1.0, 0.0, 0.0, 0.0])])


def test_it_comes_from_above_with_open_fingers(expert):
    action = expert.act(scene((0.5, 0.1, 0.3), 0.08), GOAL)
    assert action[0] > 0.05 and action[1] < -0.05 and action[6] > 0


def test_it_rises_before_it_moves_sideways(expert):
    action = expert.act(scene((0.5, 0.1, 0.02), 0.08), GOAL)
    assert action[2] > 0.2 and np.allclose(action[:2], 0)


def test_it_closes_around_the_bar_and_lifts_once_both_pads_touch(expert):
    grasp = expert.known.grasps[0]
    at = np.array(grasp.position) + [0.6, 0.0, 0.015]
    closing = expert.act(scene(at, grasp.opening), GOAL)
    assert closing[6] == -1 and np.allclose(closing[:3], 0, atol=1e-6)
    lifting = expert.act(scene(at, grasp.width), GOAL)
    assert lifting[6] == -1 and lifting[2] > 0.2


def test_it_carries_to_the_goal(expert):
    grasp = expert.known.grasps[0]
    body = np.array([0.6, -0.1, 0.2])
    action = expert.act(scene(np.array(grasp.position) + body, grasp.width, body), GOAL)
    assert action[1] > 0.2 and action[6] == -1


def test_it_has_no_memory(expert):
    poses = scene((0.5, 0.1, 0.3), 0.08)
    first = expert.act(poses, GOAL)
    expert.act(scene((0.6, 0.0, 0.02), 0.02), GOAL)
    np.testing.assert_array_equal(expert.act(poses, GOAL), first)


def test_a_fallen_object_without_a_grasp_from_above_is_left_alone(expert):
    poses = scene((0.5, 0.1, 0.3), 0.08)
    poses[3, 3:] = Rotation.from_euler("x", 50, degrees=True).as_quat(scalar_first=True)
    upright_only = PickObject(find_grasps(generated_pieces("shape_disc"), count=4))
    assert np.allclose(upright_only.act(poses, GOAL)[:3], 0)


def test_picksingleycb_runs_with_generated_shapes_and_the_expert_lifts_them(shapes):
    trials = YcbTrials(shapes)
    try:
        for name in ("shape_box", "shape_bar"):
            steps = trials.steps(name, 100, PickObject(find_grasps(shapes.pieces(name), count=8)), 150)
            assert steps is not None and 20 < steps < 120
        with pytest.raises(UnknownNameError, match="unknown object '011_banana'"):
            trials.reset("011_banana", 0)
    finally:
        trials.close()
        trials.close()
