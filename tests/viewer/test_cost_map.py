"""Maps of a cost over a scene."""

import numpy as np
import pytest
import torch
from PIL import Image

from pwm_gym.cli import main
from pwm_gym.costs import get_cost, get_grasp
from pwm_gym.errors import UnknownNameError
from pwm_gym.scene import batch_state
from pwm_gym.tasks import get_task
from pwm_gym.viewer.cost_map import cost_maps


def gap(points, info):
    """Distance (B,) from the tool to the cube, which the hand's fingers go with."""
    tool = 0.5 * (points["left_gripper"].mean(-2) + points["right_gripper"].mean(-2))
    return (tool - points["cube"].mean(-2)).norm(dim=-1)


def maps_of(scene, entity, cost=gap):
    state, goal, action = batch_state([scene]), torch.as_tensor(scene.goal)[None], torch.zeros(1, 7)
    grasp = get_grasp(get_task("PickCube").grasp)
    return cost_maps(get_cost(cost), grasp, state, goal, action, entity), state


def test_a_hand_moves_with_its_fingers_and_a_map_is_lowest_where_the_cost_is(scene):
    (flat, upright), state = maps_of(scene, "hand")
    assert (flat.axes, upright.axes) == ("x-y", "x-z") and flat.values.shape == (41, 41)
    points = {name: state.entity(name)[0].mean(0).numpy() for name in state.layout.names}
    tool = 0.5 * (points["left_gripper"] + points["right_gripper"])
    hand = state.frames[0, 0, 0, :3, 3].numpy()
    row, column = np.unravel_index(flat.values.argmin(), flat.values.shape)
    found = np.array([flat.across[column], flat.upward[row]]) - hand[:2] + tool[:2]
    np.testing.assert_allclose(found, points["cube"][:2], atol=0.006)  # cells are 7.5 mm
    here = float(gap({name: state.entity(name) for name in state.layout.names}, {}))
    assert flat.values[20, 20] == upright.values[20, 20] == pytest.approx(here, abs=1e-6)
    assert upright.upward[0] == pytest.approx(hand[2] - 0.15, abs=1e-5)


def test_moving_an_object_leaves_the_scene_itself_alone(scene):
    before = scene.poses.copy()
    (flat, _), state = maps_of(scene, "cube", "pick_cube_plan")
    assert np.ptp(flat.values) > 0.1 and np.isfinite(flat.values).all()
    np.testing.assert_array_equal(scene.poses, before)
    np.testing.assert_allclose(state.frames[0, 0, 3, :3, 3], before[0, 3, :3], atol=1e-6)
    with pytest.raises(UnknownNameError, match="mug"):
        maps_of(scene, "mug")


def test_the_command_draws_a_picture(tmp_path, capsys):
    path = tmp_path / "maps" / "cost.png"
    main(["check-cost", "--cost", "0.5 * pick_cube + pick_cube_plan", "--picture", str(path), "--move", "cube"])
    assert str(path) in capsys.readouterr().out
    pixels = np.asarray(Image.open(path).convert("RGB"))
    assert pixels.shape[0] > 300 and len(np.unique(pixels.reshape(-1, 3), axis=0)) > 200


def test_a_sequence_of_stages_is_drawn_too(tmp_path):
    path = tmp_path / "cost.png"
    main(["check-cost", "--task", "Coffee", "--cost", "coffee_plan", "--picture", str(path)])
    assert path.stat().st_size > 10_000
