import pytest
import torch

from pwm_gym.dynamics import WorldModel, build_model
from pwm_gym.dynamics.baselines.linear import BaselineConfig
from pwm_gym.errors import CheckpointError, UnknownNameError
from pwm_gym.robots import Control
from pwm_gym.scene import PointState, RigidState
from pwm_gym.scene.se3 import make_pose

CONTROL = Control(vectors=((0, 3), (3, 6)))
SHUT, OPEN = -1.0, 1.0


def build(name, layout, **settings):
    return build_model(name, layout, 7, CONTROL, settings)


def command(gripper, batch=4, x=0.0):
    action = torch.zeros(batch, 7)
    action[:, 0], action[:, 6] = x, gripper
    return action


@pytest.fixture
def grasp(hand_scenes):
    """Scenes at rest with the cube between the finger tips."""
    state = hand_scenes(4, moving=False)
    tool = torch.stack([state.entity(n).mean(1) for n in ("left_gripper", "right_gripper")]).mean(0)
    frames = state.frames.clone()
    cube = state.layout.index("cube")
    frames[:, :, cube] = make_pose(
        torch.eye(3).expand(4, 3, 3), tool - state.clouds[:, state.layout["cube"].slice].mean(1)
    )[:, None]
    return RigidState(state.layout, state.clouds, frames)


@pytest.mark.parametrize("name", ["still", "commanded", "linear"])
def test_are_world_models_that_take_points(name, hand_scenes):
    state = hand_scenes(4)
    model = build(name, state.layout)
    assert isinstance(model, WorldModel)
    assert torch.equal(model.prepare(state).frames, state.frames)
    after = model.step(model.prepare(PointState.of(state)), command(OPEN))
    assert after.points().shape == state.points().shape


def test_still_does_not_move(hand_scenes):
    state = hand_scenes(4)
    after = build("still", state.layout).step(state, command(SHUT, x=1.0))
    torch.testing.assert_close(after.points(), state.points())
    torch.testing.assert_close(after.velocity(), torch.zeros_like(state.points()))


def test_commanded_goes_where_it_is_told_at_once(hand_scenes):
    state = hand_scenes(4, moving=False)
    model = build("commanded", state.layout)
    after = model.step(state, command(OPEN, x=0.5))
    moved = (after.poses() - state.poses())[:, 0, :3, 3]
    torch.testing.assert_close(moved, torch.tensor([[0.05, 0, 0]]).expand(4, 3), atol=1e-6, rtol=0)
    openings = model.response.effector.openings(after.frames)[:, 0]
    torch.testing.assert_close(openings, torch.full((4, 2), 0.04), atol=1e-6, rtol=0)


def test_a_grasped_object_is_attached(grasp):
    model = build("commanded", grasp.layout)
    hand, cube = grasp.layout.index("hand"), grasp.layout.index("cube")
    after = model.step(grasp, command(SHUT, x=0.3))
    relative = [torch.linalg.inv(s.poses()[:, hand]) @ s.poses()[:, cube] for s in (grasp, after)]
    torch.testing.assert_close(relative[1], relative[0], atol=1e-5, rtol=0)
    assert ((after.poses() - grasp.poses())[:, cube, 0, 3] > 0.029).all()
    effector = model.response.effector  # the fingers stop at it
    torch.testing.assert_close(
        effector.openings(after.frames)[:, 0], effector.openings(grasp.frames)[:, 0], atol=1e-6, rtol=0
    )


def test_a_released_object_falls_to_the_table_and_stays(grasp):
    model, state = build("commanded", grasp.layout), grasp
    for _ in range(40):
        before = state
        state = model.step(state, command(OPEN))
    lowest = state.entity("cube")[..., 2].amin(1)
    torch.testing.assert_close(lowest, torch.zeros(4), atol=1e-5, rtol=0)
    torch.testing.assert_close(state.entity("cube"), before.entity("cube"))
    # Two steps of free fall from rest: 1 + 2 times g dt^2.
    twice = model.step(model.step(grasp, command(OPEN)), command(OPEN))
    fallen = (grasp.poses() - twice.poses())[:, grasp.layout.index("cube"), 2, 3]
    torch.testing.assert_close(fallen, torch.full((4,), 3 * 9.81 * 0.05**2), atol=1e-5, rtol=0)


def test_linear_follows_its_response(hand_scenes):
    state = hand_scenes(4, moving=False)
    model = build("linear", state.layout)
    model.response.root_weight[12, 0] = 0.02
    after = model.step(state, command(OPEN, x=0.5))
    moved = (after.poses() - state.poses())[:, 0, :3, 3]
    torch.testing.assert_close(moved, torch.tensor([[0.01, 0, 0]]).expand(4, 3), atol=1e-6, rtol=0)


def test_unknown_names_and_settings_are_answered_with_the_nearest(hand_scenes):
    layout = hand_scenes(1).layout
    with pytest.raises(UnknownNameError, match=r"unknown world model 'compct'; known: .*Did you mean 'compact'"):
        build("compct", layout)
    with pytest.raises(CheckpointError, match=r"unknown compact setting 'widht'.*Did you mean 'width'"):
        build("compact", layout, widht=3)
    assert build("linear", layout, reach=0.1).config == BaselineConfig(reach=0.1)
