from dataclasses import replace

import pytest
import torch

from pwm_gym.dynamics import WorldModel, build_model
from pwm_gym.dynamics.baselines.linear import BaselineConfig
from pwm_gym.errors import CheckpointError, UnknownNameError
from pwm_gym.robots import Channel
from pwm_gym.scene import PointState, Support
from pwm_gym.scene.se3 import make_pose

SHUT, OPEN = -1.0, 1.0
GRAVITY = 9.81


def build(name, world, **settings):
    return build_model(name, world.layout, world.control, settings)


def command(gripper, batch=4, x=0.0):
    action = torch.zeros(batch, 7)
    action[:, 0], action[:, 6] = x, gripper
    return action


def with_pose(state, name, position):
    """The scenes at rest with an entity at a place, upright."""
    frames = state.frames.clone()
    position = torch.as_tensor(position).expand(len(frames), 3)
    frames[:, :, state.layout.index(name)] = make_pose(torch.eye(3).expand(len(frames), 3, 3), position)[:, None]
    return replace(state, frames=frames)


@pytest.fixture
def world(worlds):
    return worlds["cube"]


@pytest.fixture
def grasp(world):
    """Scenes at rest with the cube at the tool's centre."""
    state = world.state(4, moving=False)
    tool = torch.tensor(world.control.arms[0].chain.tool)
    hand = state.poses()[:, 0]
    middle = state.clouds[:, state.layout["cube"].slice].mean(1)
    return with_pose(state, "cube", (hand[:, :3, :3] @ tool) + hand[:, :3, 3] - middle)


@pytest.mark.parametrize("name", ["still", "commanded", "linear"])
@pytest.mark.parametrize("scene", ["cube", "drawer", "two arms", "four", "pot", "bolted hand", "no arm"])
def test_are_world_models_of_any_robot(name, scene, worlds):
    world = worlds[scene]
    state, model = world.state(), build(name, world)
    assert isinstance(model, WorldModel)
    assert torch.equal(model.prepare(state).frames, state.frames)
    after = model.prepare(state)
    for k in range(3):
        after = model.step(after, world.actions(seed=k))
    assert after.points().isfinite().all() and after.layout is state.layout


def test_take_points(worlds):
    world = replace(worlds["drawer"], points=40)
    state, model = world.state(), build("linear", world)
    after = model.step(model.prepare(PointState.of(state)), command(OPEN, 2))
    assert after.points().shape == state.points().shape


def test_still_does_not_move(world):
    state = world.state(4)
    after = build("still", world).step(state, command(SHUT, x=1.0))
    torch.testing.assert_close(after.points(), state.points())
    torch.testing.assert_close(after.velocity(), torch.zeros_like(state.points()))


def test_commanded_goes_where_it_is_told_at_once(world):
    state, model = world.state(4, moving=False), build("commanded", world)
    after = model.step(state, command(OPEN, x=0.5))
    moved = (after.poses() - state.poses())[:, 0, :3, 3]
    torch.testing.assert_close(moved, torch.tensor([[0.05, 0, 0]]).expand(4, 3), atol=1e-6, rtol=0)
    openings = model.response.tree.positions(after.poses()[:, :3])
    torch.testing.assert_close(openings, torch.full((4, 2), 0.04), atol=1e-6, rtol=0)


def test_commanded_arms_go_each_its_own_way(worlds):
    world = worlds["two arms"]
    state, action = world.state(moving=False), torch.zeros(2, 24)
    action[:, 0], action[:, 13] = 1.0, -1.0  # left along x, right along y, 5 cm a unit
    after = build("commanded", world).step(state, action)
    way = after.poses() - state.poses()
    left, right = (way[:, state.layout.index(f"{side}_hand"), :3, 3] for side in ("left", "right"))
    torch.testing.assert_close(left, torch.tensor([[0.05, 0, 0]]).expand(2, 3), atol=1e-6, rtol=0)
    torch.testing.assert_close(right, torch.tensor([[0, -0.05, 0]]).expand(2, 3), atol=1e-6, rtol=0)


@pytest.mark.parametrize("both", [True, False])
def test_commanded_grippers_are_each_arms_own(worlds, both):
    channels = [Channel("gripper", 0, 1, rest=1.0, arm="right"), Channel("gripper", 1, 2, rest=1.0, arm="left")]
    control = replace(worlds["two arms"].control, channels=tuple(channels if both else channels[:1]))
    world = replace(worlds["two arms"], control=control)
    state, model = world.state(moving=False), build("commanded", world)
    after = model.step(state, torch.tensor([[OPEN, SHUT][: control.size]] * 2))
    tree, links = model.response.tree, [state.layout.index(name) for name in model.links.names]
    names = [model.links.names[i] for i in tree.moving]
    before, found = (dict(zip(names, tree.positions(s.poses()[:, links]).T, strict=True)) for s in (state, after))
    assert found["right_index"].tolist() == pytest.approx([1.2, 1.2], abs=1e-3)
    left = [-0.2, -0.2] if both else before["left_index"].tolist()  # an arm without a gripper: its linear response
    assert found["left_index"].tolist() == pytest.approx(left, abs=1e-3)


def test_a_grasped_object_is_attached(world, grasp):
    model = build("commanded", world)
    hand, cube = grasp.layout.index("hand"), grasp.layout.index("cube")
    after = model.step(grasp, command(SHUT, x=0.3))
    relative = [torch.linalg.inv(s.poses()[:, hand]) @ s.poses()[:, cube] for s in (grasp, after)]
    torch.testing.assert_close(relative[1], relative[0], atol=1e-5, rtol=0)
    assert ((after.poses() - grasp.poses())[:, cube, 0, 3] > 0.029).all()
    tree = model.response.tree  # the fingers stop at it
    torch.testing.assert_close(
        tree.positions(after.poses()[:, :3]), tree.positions(grasp.poses()[:, :3]), atol=1e-6, rtol=0
    )


def test_only_what_the_tool_is_at_is_attached(worlds, new_body):
    world = worlds["cube"].plus(ball=new_body((0.02, 0.02, 0.02), (0.3, 0.4, 0.02)))
    state = world.state(2, moving=False)
    after = build("commanded", world).step(state, command(SHUT, 2, x=0.3))
    assert (after.poses() - state.poses())[:, 3:, :2, 3].abs().max() < 1e-6


def test_a_released_object_falls_to_the_table_and_stays(world, grasp):
    model, state = build("commanded", world), grasp
    for _ in range(40):
        before = state
        state = model.step(state, command(OPEN))
    lowest = state.entity("cube")[..., 2].amin(1)
    torch.testing.assert_close(lowest, torch.zeros(4), atol=1e-5, rtol=0)
    torch.testing.assert_close(state.entity("cube"), before.entity("cube"))
    # Two steps of free fall from rest: 1 + 2 times g dt^2.
    twice = model.step(model.step(grasp, command(OPEN)), command(OPEN))
    fallen = (grasp.poses() - twice.poses())[:, grasp.layout.index("cube"), 2, 3]
    torch.testing.assert_close(fallen, torch.full((4,), 3 * GRAVITY * 0.05**2), atol=1e-5, rtol=0)


def settled(world, state, count=30):
    model = build("linear", world)
    for _ in range(count):
        state = model.step(state, torch.zeros(len(state.frames), world.control.size))
    return state


def test_objects_fall_onto_what_is_below_them(worlds, new_body):
    cube = new_body((0.02, 0.02, 0.02), (0.5, -0.3, 0.3))  # over the box
    world = (
        worlds["lid"]
        .only("hand", "left_gripper", "right_gripper", "box")
        .plus(cube=cube, other=replace(cube, at=(0.5, -0.3, 0.4)), aside=replace(cube, at=(0.9, 0, 1)))
    )
    state = world.state(2, moving=False, spread=0.0)
    for name in ("cube", "other", "aside"):
        state = with_pose(state, name, world.bodies[name].at)
    after = settled(world, state)
    box = after.entity("box")[..., 2].amax(1)
    heights = {name: after.entity(name)[..., 2] for name in ("cube", "other", "aside")}
    torch.testing.assert_close(heights["cube"].amin(1), box, atol=1e-5, rtol=0)
    torch.testing.assert_close(heights["other"].amin(1), heights["cube"].amax(1), atol=1e-5, rtol=0)
    torch.testing.assert_close(heights["aside"].amin(1), torch.zeros(2), atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("degrees", "at", "height"),
    [
        (0.0, (0.7, 0.0), 0.2),
        (90.0, (0.7, 0.0), 0.0),
        (90.0, (0.6, 0.1), 0.2),
        (45.0, (0.7, 0.1), 0.2),
        (45.0, (0.7, -0.1), 0.0),  # beside it, but within its extent along the base's axes
    ],
)
def test_a_support_is_where_it_is_turned_to(world, degrees, at, height):
    half = torch.deg2rad(torch.tensor(degrees / 2))
    wall = Support((0.6, 0.0, 0.1, float(half.cos()), 0.0, 0.0, float(half.sin())), (0.2, 0.02, 0.1))
    state = with_pose(world.state(1, moving=False), "cube", (*at, 0.3))
    state = replace(state, layout=replace(state.layout, supports=(*state.layout.supports, wall)))
    after = settled(world, state)
    assert float(after.entity("cube")[..., 2].min()) == pytest.approx(height, abs=1e-5)


def test_an_object_in_the_ground_does_not_fall_through_it(world):
    state = with_pose(world.state(1, moving=False), "cube", (0.6, 0.0, -0.1))
    after = settled(world, state, 5)
    assert torch.equal(after.poses()[:, 3], state.poses()[:, 3])


def test_what_hangs_on_an_object_falls_with_it(worlds):
    world = worlds["pot"]
    state = world.state(1, moving=False)
    layout, lifted = state.layout, state.frames.clone()
    lifted[:, :, [layout.index(name) for name in ("pot", "grip", "cover", "stopper")], 2, 3] += 0.5
    state = replace(state, frames=lifted)
    relative = torch.linalg.inv(state.poses()[:, [layout.index("pot")]]) @ state.poses()
    after = settled(world, state, 8)
    again = torch.linalg.inv(after.poses()[:, [layout.index("pot")]]) @ after.poses()
    assert (state.poses() - after.poses())[0, layout.index("pot"), 2, 3] > 0.3
    hanging = [layout.index(name) for name in ("grip", "cover", "stopper")]
    torch.testing.assert_close(again[:, hanging], relative[:, hanging], atol=1e-5, rtol=0)


def test_linear_follows_its_response(world):
    state, model = world.state(4, moving=False), build("linear", world)
    model.response.hand_weight[0, 12, 0] = 0.02
    after = model.step(state, command(OPEN, x=0.5))
    moved = (after.poses() - state.poses())[:, 0, :3, 3]
    torch.testing.assert_close(moved, torch.tensor([[0.01, 0, 0]]).expand(4, 3), atol=1e-6, rtol=0)


def test_unknown_names_and_settings_are_answered_with_the_nearest(world):
    with pytest.raises(UnknownNameError, match=r"unknown world model 'compct'; known: .*Did you mean 'compact'"):
        build("compct", world)
    with pytest.raises(CheckpointError, match=r"unknown compact setting 'widht'.*Did you mean 'width'"):
        build("compact", world, widht=3)
    with pytest.raises(CheckpointError, match=r"compact settings: Expected `int`, got `str` - at `\$\.width`"):
        build("compact", world, width="wide")
    assert build("linear", world, reach=0.1).config == BaselineConfig(reach=0.1)
