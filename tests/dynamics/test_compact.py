from dataclasses import replace

import pytest
import torch
from acting import EVERY, many_actions, moved, on, reordered, steps

from pwm_gym.dynamics import CompactModel, WorldModel, build_model, rollout
from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.robots import Channel, Control
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import FIXED, Joint, Layout, Mimic, PointState, RigidState
from pwm_gym.scene.se3 import make_pose, rotation_from_vector
from pwm_gym.tasks import get_task

# Scenes of every kind


@torch.no_grad()
@pytest.mark.parametrize("name", EVERY)
def test_steps_in_every_kind_of_scene(worlds, name):
    world = worlds[name]
    model, state = world.model(), world.state()
    assert isinstance(model, WorldModel)
    states = steps(model, state, many_actions(world, 12))
    last = states[-1]
    assert last.frames.isfinite().all() and last.layout is state.layout
    rotation = last.poses()[..., :3, :3]
    torch.testing.assert_close(
        rotation @ rotation.transpose(-1, -2), torch.eye(3).expand_as(rotation), atol=1e-4, rtol=0
    )
    for e in state.layout:
        still = e.joint.kind == "fixed" and e.joint.parent is None
        assert (moved(states[0], state, e.name) > 1e-5) != still, e.name  # so that the tests below compare something


@torch.no_grad()
@pytest.mark.parametrize("name", ["cube", "drawer", "lid", "two arms", "pot", "bolted hand", "no arm"])
def test_what_hangs_on_a_joint_stays_on_it_within_its_limits(worlds, name):
    world = worlds[name]
    model, state = world.model(), world.state()
    layout = state.layout
    tree = JointTree(layout, [i for i, e in enumerate(layout) if e.joint.moves])
    spread = []
    for after in steps(model, state, many_actions(world, 15)):
        q = tree.positions(after.poses())
        torch.testing.assert_close(tree.place(after.poses(), q), after.poses(), atol=1e-5, rtol=0)
        assert (q > tree.lower - 1e-5).all() and (q < tree.upper + 1e-5).all()
        spread.append(q)
    assert (torch.stack(spread).std(0) > 1e-4).all()


@torch.no_grad()
def test_what_is_fixed_to_something_goes_with_it(worlds):
    pairs = {
        "drawer": [("drawer", "handle")],
        "lid": [("lid", "knob")],
        "two arms": [("left_tip", "left_nail"), ("right_tip", "right_nail"), ("drawer", "handle")],
        "pot": [("pot", "grip")],
    }
    for name, on_each_other in pairs.items():
        world = worlds[name]
        states = steps(world.model(), world.state(), many_actions(world, 6))
        for parent, child in on_each_other:
            assert moved(states[-1], world.state(), child) > 1e-3
            torch.testing.assert_close(
                on(states[-1], parent, child), on(world.state(), parent, child), atol=1e-4, rtol=0
            )


@torch.no_grad()
def test_a_part_that_hangs_on_what_is_fixed_to_a_hand_goes_with_it(worlds, new_body):
    """A finger on a plate that is screwed to the hand: listed before the plate."""
    finger = Joint("revolute", "plate", axis=(1.0, 0.0, 0.0), lower=0.2, upper=0.2)
    plate = Joint("fixed", "hand", (0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0))
    world = worlds["unknown arm"].plus(
        plate=new_body((0.02, 0.02, 0.01), joint=plate, driven=True),
        finger=new_body((0.01, 0.01, 0.02), joint=finger, driven=True),
    )
    start = reordered(world.state(), [0, 3, 2, 1])
    model = build_model("compact", start.layout, world.control, {"width": 16, "points": 4}).eval()
    model.robot.response.hand_weight.normal_(std=0.02)
    last = steps(model, start, many_actions(world, 5))[-1]
    assert moved(last, start, "hand") > 0.01
    torch.testing.assert_close(on(last, "hand", "finger"), on(start, "hand", "finger"), atol=1e-5, rtol=0)


@torch.no_grad()
def test_joints_of_a_scene_follow_each_other(worlds, new_body):
    door = Joint("revolute", "box", (0.0, 0.1, 0.06, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), -1.0, 1.0)
    other = replace(door, origin=(0.0, -0.1, 0.06, 1.0, 0.0, 0.0, 0.0), mimic=Mimic("lid", -1.0, 0.1))
    world = worlds["lid"].plus(flap=new_body((0.1, 0.05, 0.01), joint=other))
    state = world.state()
    tree = JointTree(state.layout, [state.layout.index("lid"), state.layout.index("flap")])
    seen = []
    for after in steps(world.model(), state, many_actions(world, 10)):
        lid, flap = tree.positions(after.poses()).unbind(-1)
        torch.testing.assert_close(flap, (0.1 - lid).clamp(-1.0, 1.0), atol=1e-5, rtol=0)
        seen.append(lid)
    assert torch.stack(seen).std(0).min() > 1e-3


# What the parameters belong to


@torch.no_grad()
@pytest.mark.parametrize("name", ["drawer", "two arms", "pot", "no arm"])
def test_the_order_of_the_entities_does_not_matter(worlds, name):
    world = worlds[name]
    model, state, action = world.model(), world.state(), world.actions()
    order = torch.randperm(len(state.layout), generator=torch.Generator().manual_seed(1)).tolist()
    mixed = reordered(state, order)
    expected = model.step(model.prepare(state), action)
    found = model.step(model.prepare(mixed), action)
    assert found.layout.names == tuple(state.layout.names[k] for k in order)
    torch.testing.assert_close(found.poses(), expected.poses()[:, order], atol=1e-5, rtol=0)
    torch.testing.assert_close(found.error, expected.error[:, order], atol=1e-6, rtol=0)


@torch.no_grad()
def test_names_of_objects_do_not_matter(worlds):
    state, model, action = worlds["drawer"].state(), worlds["drawer"].model(), worlds["drawer"].actions()

    def renamed(e):
        if e.driven:
            return e
        parent = e.joint.parent and f"other {e.joint.parent}"
        return replace(e, name=f"other {e.name}", joint=replace(e.joint, parent=parent))

    layout = replace(state.layout, entities=tuple(map(renamed, state.layout)))
    after = [model.step(model.prepare(s), action) for s in (state, replace(state, layout=layout))]
    assert torch.equal(after[0].poses(), after[1].poses())


@torch.no_grad()
def test_one_set_of_weights_serves_every_scene_of_its_robot(worlds):
    first = worlds["cube"].model(seed=3)
    for name in ("drawer", "lid", "pot"):
        other = worlds[name].model(seed=4)
        other.load_state_dict(first.state_dict())
        state, action = worlds[name].state(), worlds[name].actions()
        expected = other.step(other.prepare(state), action).poses()
        assert torch.equal(first.step(first.prepare(state), action).poses(), expected)


@torch.no_grad()
def test_equal_objects_move_alike_wherever_they_are_listed(worlds, new_body):
    """Two cubes far from all else, one a metre beside the other: no weight knows which is which."""
    at = (0.6, 3.0, 0.5)
    world = worlds["no arm"].plus(a=new_body((0.02,) * 3, at, FIXED), b=new_body((0.02,) * 3, at, FIXED))
    state = world.state(1)
    free = [replace(e, joint=Joint()) if e.name in "ab" else e for e in state.layout]
    a, b = state.layout.index("a"), state.layout.index("b")
    clouds = state.clouds.clone()
    clouds[:, free[b].slice] = clouds[:, free[a].slice]
    state = replace(state, layout=replace(state.layout, entities=tuple(free)), clouds=clouds)
    model = world.model()
    after = model.step(model.prepare(state), world.actions(1))
    torch.testing.assert_close(after.poses()[:, a], after.poses()[:, b], atol=1e-6, rtol=0)


def test_a_model_of_another_robot_is_refused(worlds):
    model = worlds["cube"].model()
    with pytest.raises(SceneError, match=r"robot has palm, finger; expected hand, left_gripper, right_gripper"):
        model.prepare(worlds["bolted hand"].state())
    with pytest.raises(SceneError, match="robot has no link; expected hand"):
        model.prepare(worlds["no arm"].state())
    state = worlds["cube"].state()
    wrong = [replace(e, joint=FIXED) if e.name == "left_gripper" else e for e in state.layout]
    with pytest.raises(SceneError, match=r"joint of 'left_gripper' is fixed on None; the model's is prismatic on hand"):
        model.prepare(replace(state, layout=replace(state.layout, entities=tuple(wrong))))


def test_an_arm_without_its_hand_is_refused(worlds):
    with pytest.raises(SceneError, match="arm 'arm' has hand 'hand'; the robot's are none"):
        build_model("compact", worlds["no arm"].layout, worlds["cube"].control)


def test_an_arm_that_is_driven_joint_by_joint_is_fitted(worlds):
    """Its chain is known, but not how its joints follow an action."""
    joints, gripper = Channel("joint", 0, 7, rest=None, arm="arm"), Channel("gripper", 7, 8, rest=1.0, arm="arm")
    control = Control((joints, gripper), worlds["cube"].control.arms)
    world = replace(worlds["cube"], control=control)
    model, state, action = world.model(), world.state(), world.actions()
    assert model.robot.known == [False] and model.prepare(state).joints is None
    after = model.step(model.prepare(state), action)
    other = model.step(model.prepare(state), action + torch.eye(8)[3])
    assert after.points().isfinite().all()
    assert (after.poses()[:, 0] - other.poses()[:, 0]).abs().max() > 1e-5


def test_joints_of_another_number_are_refused(worlds):
    state = worlds["cube"].state()
    with pytest.raises(SceneError, match=r"the robot has 5 joints; expected 7 at least"):
        worlds["cube"].model().prepare(replace(state, joints=state.joints[..., :5]))


# Symmetries


def equivariant(response):
    """Random response weights that turn with the scene: as of a controller that treats x and y alike."""
    generator = torch.Generator().manual_seed(1)
    weight = torch.zeros_like(response.hand_weight[0])
    for i in range(0, 18, 3):  # two twists and the action's two vectors
        for j in range(0, 6, 3):
            a, b, c = 0.02 * torch.randn(3, generator=generator)
            weight[i : i + 3, j : j + 3] = torch.tensor([[a, b, 0], [-b, a, 0], [0, 0, c]])
    weight[18, [2, 5]] = 0.01 * torch.randn(2, generator=generator)
    response.hand_weight.copy_(weight)
    if len(response.tree):
        response.joint_weight.normal_(std=0.01, generator=generator)
        response.joint_weight[6:12] = 0.0  # the arm's command


@torch.no_grad()
@pytest.mark.parametrize("name", ["cube", "drawer", "lid", "pot"])
@pytest.mark.parametrize("angle", [0.3, 3.1])
def test_turning_the_scene_about_the_vertical_turns_the_prediction(worlds, name, angle):
    world = worlds[name]
    model, state, action = world.model(kinematic=False), world.state(), world.actions()
    equivariant(model.robot.response)
    turn = make_pose(rotation_from_vector(torch.tensor([0.0, 0.0, angle])), torch.zeros(3))
    turned = replace(state, frames=turn @ state.frames)
    vectors = (action[:, :6].view(2, 2, 3) @ turn[:3, :3].T).flatten(1)
    after = model.step(model.prepare(turned), torch.cat([vectors, action[:, 6:]], 1))
    plain = model.step(model.prepare(state), action)
    torch.testing.assert_close(after.poses(), turn @ plain.poses(), atol=1e-5, rtol=0)
    assert moved(plain, state, "hand") > 1e-3


@torch.no_grad()
def test_another_height_is_another_prediction(worlds):
    """Gravity and the table: it is no equivariance to every motion."""
    model, state, action = worlds["cube"].model(kinematic=False), worlds["cube"].state(), worlds["cube"].actions()
    lift = make_pose(torch.eye(3), torch.tensor([0.0, 0.0, 0.05]))
    lifted = model.step(model.prepare(replace(state, frames=lift @ state.frames)), action).poses()
    assert (lifted - lift @ model.step(model.prepare(state), action).poses()).abs().max() > 1e-4


@torch.no_grad()
def test_the_order_of_an_entitys_points_does_not_matter(worlds):
    world = replace(worlds["pot"], points=12)
    model, state, action = world.model(), world.state(), world.actions()
    generator = torch.Generator().manual_seed(3)
    order = torch.cat([e.start + torch.randperm(e.points, generator=generator) for e in state.layout])
    found = [
        model.step(model.prepare(s), action).poses() for s in (state, replace(state, clouds=state.clouds[:, order]))
    ]
    torch.testing.assert_close(found[1], found[0], atol=1e-5, rtol=0)


@torch.no_grad()
@pytest.mark.parametrize("name", ["cube", "two arms", "pot", "no arm"])
def test_a_scene_does_not_depend_on_its_batch(worlds, name):
    model, state, action = worlds[name].model(), worlds[name].state(4), worlds[name].actions(4)
    start = model.prepare(state)
    together = model.step(start, action).poses()
    for b in range(4):
        alone = model.step(start[b : b + 1], action[b : b + 1]).poses()
        torch.testing.assert_close(alone, together[b : b + 1], atol=1e-6, rtol=0)
    assert torch.equal(model.step(start, action).poses(), together)  # and nothing in it is random
    assert model.step(start[:0], action[:0]).frames.shape == (0, *state.frames.shape[1:])


# Gradients


@pytest.mark.parametrize("name", ["drawer", "two arms", "pot"])
def test_gradients_reach_every_parameter(worlds, name):
    world = worlds[name]
    model, state = world.model(), world.state()
    states = rollout(model, state, many_actions(world, 2).transpose(0, 1))
    states.points().square().sum().backward()
    trained = {n: p.grad for n, p in model.named_parameters() if not n.startswith("error.")}
    assert [n for n, grad in trained.items() if grad is None or not grad.abs().sum() > 0] == []
    assert all(grad.isfinite().all() for grad in trained.values())
    assert all(p.grad is None for p in model.error.parameters())  # it is fitted when the rest is done


@pytest.mark.parametrize("name", ["cube", "four", "two arms", "lid"])
def test_gradients_reach_the_actions(worlds, name):
    world = worlds[name]
    model, state = world.model(), world.state()
    actions = many_actions(world, 3).requires_grad_()
    last = steps(model, state, actions)[-1]
    last.points().square().sum().backward()
    assert actions.grad.isfinite().all()
    assert (actions.grad.abs().sum((0, 1)) > 0).all()


# Sizes and settings


def test_the_default_is_small():
    task = get_task("PickCube")
    count = sum(p.numel() for p in CompactModel(task.layout, task.control).parameters())
    assert 0.2e6 < count < 0.35e6


def test_no_blocks_is_a_clear_error(worlds):
    with pytest.raises(PwmGymError, match="blocks=0; expected at least 1"):
        worlds["cube"].model(blocks=0)


@torch.no_grad()
def test_scenes_of_any_number_of_points_work(worlds):
    world = worlds["pot"]
    model, state, action = world.model(), world.state(), world.actions()
    coarse = state.coarsen(state.layout.truncate(5))
    after = model.step(model.prepare(coarse), action)
    assert after.points().shape == (2, 5 * len(state.layout), 3) and after.layout == coarse.layout
    few = state.coarsen(state.layout.truncate(model.read_points))
    full = model.step(model.prepare(state), action).poses()
    torch.testing.assert_close(model.step(model.prepare(few), action).poses(), full, atol=1e-6, rtol=0)


@torch.no_grad()
def test_a_robot_alone_works(worlds):
    world = worlds["two arms"]
    robot = world.only(*(n for n, b in world.bodies.items() if b.driven))
    model, state = robot.model(), robot.state()
    last = steps(model, state, many_actions(robot, 3))[-1]
    assert moved(last, state) > 1e-3 and last.frames.isfinite().all()


@torch.no_grad()
def test_points_are_registered_to_poses(worlds):
    world = replace(worlds["drawer"], points=40)
    model, state, action = world.model(), world.state(), world.actions()
    state = replace(state, joints=None)
    prepared = model.prepare(PointState.of(state))
    assert isinstance(prepared, RigidState)
    expected = model.step(model.prepare(state), action).poses()
    torch.testing.assert_close(model.step(prepared, action).poses(), expected, atol=2e-3, rtol=0)


@torch.no_grad()
def test_more_layouts_than_are_remembered_work(worlds):
    world = worlds["unknown arm"]
    model, state, action = world.model(), world.state(), world.actions()
    expected = model.step(model.prepare(state), action).poses()
    for _ in range(40):
        copy = replace(state, layout=Layout.from_json(state.layout.to_json()))
        assert torch.equal(model.step(model.prepare(copy), action).poses(), expected)


@torch.no_grad()
@pytest.mark.parametrize("blocks", [1, 2])
@pytest.mark.parametrize("name", ["cube", "two arms"])
def test_what_is_near_the_robot_and_not_touched_does_not_change_how_it_moves(worlds, name, blocks):
    world = worlds[name]
    state, action = world.state(moving=False), world.actions()
    links = [k for k, e in enumerate(state.layout) if e.driven]
    loose = state.layout.loose[0]

    def moves(gaps, away, turn):
        """Links' next poses beside a loose body that is ``away`` and turned by a vector."""
        frames = state.frames.clone()
        frames[:, :, loose, 0, 3] += away
        frames[:, :, loose, :3, :3] = rotation_from_vector(torch.tensor(turn)) @ frames[:, :, loose, :3, :3]
        model = world.model(hidden_gaps=gaps, blocks=blocks)
        return model.step(model.prepare(replace(state, frames=frames)), action).poses()[:, links]

    def difference(gaps, away):
        return float((moves(gaps, away, [0.0, 0.0, 0.0]) - moves(gaps, away, [0.4, -0.7, 0.2])).abs().max())

    assert difference((0.01, 3.0), 2.0) < 1e-6 < difference((0.0, 0.0), 2.0)
    assert difference((0.01, 0.5), 2.0) > 1e-6  # farther than that, it is seen


def test_gaps_that_cannot_be_are_refused(worlds):
    with pytest.raises(PwmGymError, match=r"hidden_gaps=\(0.1, 0.02\); expected 0 <= from <= to"):
        worlds["cube"].model(hidden_gaps=(0.1, 0.02))
