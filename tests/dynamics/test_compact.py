from dataclasses import replace

import pytest
import torch

from pwm_gym.dynamics import CompactModel, WorldModel, build_model, rollout
from pwm_gym.dynamics.compact.attention import Block
from pwm_gym.dynamics.compact.movers import _gate
from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.robots import Channel, Control
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import FIXED, Joint, Layout, Mimic, PointState, RigidState, Support
from pwm_gym.scene.se3 import make_pose, rotation_from_vector
from pwm_gym.tasks import get_task

EVERY = [
    "cube", "drawer", "lid", "four", "unknown arm", "two arms", "pot", "bolted hand", "no arm", "one thing"
]  # fmt: skip
GRAVITY = 9.81


def steps(model, state, actions):
    """States after each of the actions (T, B, A)."""
    state, found = model.prepare(state), []
    for action in actions:
        state = model.step(state, action)
        found.append(state)
    return found


def many_actions(world, count, batch=2):
    return torch.stack([world.actions(batch, seed=k) for k in range(count)])


def at_rest(world, count, batch=2):
    return torch.zeros(count, batch, world.control.size)


def moved(a, b, *names):
    """Largest difference of the poses of entities called so (all, if none is given) in two states."""
    places = [a.layout.index(n) for n in names] or slice(None)
    return float((a.poses() - b.poses())[:, places].abs().max())


def on(state, parent, child):
    """Pose (B, 4, 4) of one entity in another's frame."""
    names = state.layout.index
    return torch.linalg.inv(state.poses()[:, names(parent)]) @ state.poses()[:, names(child)]


def reordered(state, order):
    """The same scenes with their entities in the order of ``order``, places in the old layout."""
    old = state.layout
    entities = [old.entities[k] for k in order]
    layout = replace(old, entities=()).plus(entities)
    return replace(
        state, layout=layout, clouds=torch.cat([state.clouds[:, e.slice] for e in entities], 1),
        frames=state.frames[:, :, order],
    )  # fmt: skip


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


# Gates


@torch.no_grad()
@pytest.mark.parametrize("name", ["cube", "two arms", "pot", "no arm"])
def test_an_untouched_scene_rests_exactly(worlds, set_gates, name):
    world = worlds[name]
    model, state = set_gates(world.model(), fall=0.0), world.state(1, moving=False)
    for head in (model.robot.slide, *model.robot.heads):  # which a trained model does not use at rest
        head.weight.zero_()
        head.bias.zero_()
    assert moved(steps(model, state, at_rest(world, 50, 1))[-1], state) < 2e-6


@torch.no_grad()
def test_shut_gates_leave_objects_where_they_are_whatever_the_robot_does(worlds, set_gates):
    for name in ("drawer", "lid", "two arms", "pot"):
        world = worlds[name]
        model, state = set_gates(world.model()), world.state()
        last = steps(model, state, many_actions(world, 8))[-1]
        assert moved(last, state, *(e.name for e in state.layout if not e.driven)) < 2e-6
        assert moved(last, state, state.layout.names[0]) > 1e-3


@torch.no_grad()
def test_a_held_object_moves_with_the_hand_exactly(worlds, set_gates):
    world = worlds["cube"]
    model, state = set_gates(world.model(), links=[20.0, -20.0, -20.0]), world.state()
    states = steps(model, state, many_actions(world, 20))
    assert moved(states[-1], state, "hand") > 0.01
    for after in states:
        torch.testing.assert_close(on(after, "hand", "cube"), on(state, "hand", "cube"), atol=5e-6, rtol=0)


@torch.no_grad()
def test_a_held_pot_takes_all_that_hangs_on_it_along(worlds, set_gates):
    world = worlds["pot"]
    model, state = set_gates(world.model(), links=[20.0, -20.0, -20.0]), world.state(moving=False)
    model.movers.head.bias[3:] = 0.0
    names = ("pot", "grip", "cover", "stopper")
    relative = [on(state, "pot", n) for n in names]
    # The joints' own gates take the hand's way along them; shut them by their limits.
    locked = [
        replace(e, joint=replace(e.joint, lower=q, upper=q)) if e.name in ("cover", "stopper") else e
        for e, q in zip(state.layout, positions(state), strict=True)
    ]
    state = replace(state[:1], layout=replace(state.layout, entities=tuple(locked)))
    last = steps(model, state, many_actions(world, 10, 1))[-1]
    assert moved(last, state, "pot") > 0.01
    for name, before in zip(names, relative, strict=True):
        torch.testing.assert_close(on(last, "pot", name), before[:1], atol=2e-5, rtol=0)


def positions(state):
    """Position of each entity's joint in the first scene; 0 where it has none."""
    tree = JointTree(state.layout, [i for i, e in enumerate(state.layout) if e.joint.moves])
    found = dict(zip(tree.moving, tree.positions(state.poses())[0].tolist(), strict=True))
    return [found.get(i, 0.0) for i in range(len(state.layout))]


@torch.no_grad()
def test_what_lies_in_a_drawer_rides_on_it(worlds, set_gates, new_body):
    """Articulated parts carry: a hand pulls the drawer, and the cube in it goes along."""
    world = worlds["drawer"]
    model, state = set_gates(world.model(), links=-20.0, others=[-20.0, -20.0, 20.0, -20.0]), world.state(moving=False)
    model.movers.head.bias[3:] = torch.tensor([0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    model.movers.head.weight[3:] = 0.0
    place = state.layout.index("cube")
    frames = state.frames.clone()
    frames[:, :, place] = frames[:, :, state.layout.index("drawer")]
    state = replace(state, frames=frames)
    model.movers.head.bias[0] = 20.0  # the learned motion slides the drawer by 4 mm a step ...
    last = steps(model, state, at_rest(world, 3))[-1]
    slid = (last.poses() - state.poses())[:, state.layout.index("drawer"), :3, 3].norm(dim=-1)
    torch.testing.assert_close(slid, torch.full((2,), 0.012), atol=1e-4, rtol=0)
    # ... and the cube by as much, besides its own learned 4 mm in the hand's frame
    own = last.poses()[:, 0, :3, :3] @ torch.tensor([0.012, 0.0, 0.0])
    went = (last.poses() - state.poses())[:, place, :3, 3] - own
    along = (last.poses() - state.poses())[:, state.layout.index("drawer"), :3, 3]
    torch.testing.assert_close(went, along, atol=1e-4, rtol=0)


@torch.no_grad()
def test_an_object_in_free_flight_falls_and_goes_on_turning(worlds, set_gates):
    world, count = worlds["cube"], 4
    model, state = set_gates(world.model(), flying=20.0), world.state()
    frames = state.frames.clone()
    frames[:, :, 3, :2, 3] += 1.0  # away from the hand
    frames[:, :, 3, 2, 3] += 1.0
    state = replace(state, frames=frames)
    cube = state.layout["cube"]
    middle = state.clouds[:, cube.slice][:, : model.config.points].mean(1)

    def centre(poses):
        return (poses[:, 3, :3, :3] @ middle.unsqueeze(-1)).squeeze(-1) + poses[:, 3, :3, 3]

    start, before = (centre(state.frames[:, k]) for k in (0, 1))
    rotation = state.frames[:, 0, 3, :3, :3]
    turn = rotation @ state.frames[:, 1, 3, :3, :3].transpose(1, 2)
    for _ in range(count):
        rotation = turn @ rotation
    last = steps(model, state, many_actions(world, count))[-1].poses()
    expected = start + count * (start - before)
    expected[:, 2] -= GRAVITY * world.control.period**2 * count * (count + 1) / 2
    torch.testing.assert_close(centre(last), expected, atol=2e-5, rtol=0)
    torch.testing.assert_close(last[:, 3, :3, :3], rotation, atol=1e-4, rtol=0)


@torch.no_grad()
@pytest.mark.parametrize("creep", [0.0, 1e-7, 1e-5])
def test_what_rests_on_something_does_not_fall(worlds, set_gates, new_body, creep):
    """Flight gates are open: on the ground, on a fixed box and on another object nothing falls; in mid-air all does."""
    cube = new_body((0.02, 0.02, 0.02), (0.5, -0.3, 0.02))
    world = worlds["lid"].only("hand", "left_gripper", "right_gripper", "box").plus(
        low=replace(cube, at=(0.9, 0.2, 0.02)),
        above=replace(cube, at=(0.9, 0.2, 0.06)),
        onbox=replace(cube, at=(0.5, -0.3, 0.12)),
        high=replace(cube, at=(0.2, 0.6, 0.5)),
    )  # fmt: skip
    model, state = set_gates(world.model(), flying=20.0), world.state(1, moving=False, spread=0.0)
    objects = [state.layout.index(n) for n in ("low", "above", "onbox", "high")]
    frames = state.frames.clone()
    frames[:, :, objects, :3, :3] = torch.eye(3)
    frames[:, 1:, objects, 2, 3] += creep
    state = replace(state, frames=frames)
    last = steps(model, state, at_rest(world, 12, 1))[-1]
    assert moved(last, state, "low", "above", "onbox") < 2e-6
    first = steps(model, state, at_rest(world, 1, 1))[-1]
    fallen = (state.poses() - first.poses())[0, state.layout.index("high"), 2, 3]
    assert fallen == pytest.approx(GRAVITY * world.control.period**2, abs=2e-5)


def contacts_of(model, state, action):
    seen = []
    hook = model.contact.register_forward_hook(lambda module, given, told: seen.append(told))
    model.step(model.prepare(state), action)
    hook.remove()
    return seen[0]


@torch.no_grad()
def test_contacts_tell_who_touches_whom_and_the_way_out(worlds, new_body):
    world = worlds["no arm"].only("cube").plus(table=new_body((0.2, 0.2, 0.05), (0.6, 0.0, 0.3), FIXED))
    world = replace(world, points=60)
    model = world.model(points=60)
    start = world.state(1, moving=False, spread=0.0)

    def at(height):
        frames = start.frames.clone()
        frames[:, :, 0] = make_pose(torch.eye(3), torch.tensor([0.6, 0.0, height]))
        return contacts_of(model, replace(start, frames=frames), world.actions(1))

    inside, touching, apart = at(0.367), at(0.3701), at(0.6)  # the table's top is at 0.35, half the cube is 0.02
    torch.testing.assert_close(inside.push[0, 0, 1], torch.tensor([0.0, 0.0, 0.003]), atol=1e-6, rtol=0)
    assert (touching.push == 0).all() and (apart.push == 0).all()
    assert (inside.push[:, :, 0] == 0).all()  # itself
    assert inside.unsupported.item() == touching.unsupported.item() == 0.0 and apart.unsupported.item() == 1.0
    gap, gap_next = 0, 1
    assert inside.pairs[0, 0, 1, gap_next] < -0.3 < 0.1 > touching.pairs[0, 0, 1, gap].abs()
    assert apart.pairs[0, 0, 1, gap] > 0.99


@torch.no_grad()
def test_walls_are_touched(worlds, new_body):
    """A fixed box of the world without points: what it says is what a fixed entity says."""
    world = worlds["no arm"].only("cube")
    start = world.state(1, moving=False, spread=0.0)
    shelf = Support((0.6, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0), (0.2, 0.2, 0.05))
    model = world.model()
    for height, expected in ((0.371, 0.0), (0.5, 1.0)):
        frames = start.frames.clone()
        frames[:, :, 0] = make_pose(torch.eye(3), torch.tensor([0.6, 0.0, height]))
        layout = replace(start.layout, supports=(Support.ground(), shelf))
        state = replace(start, layout=layout, frames=frames)
        assert contacts_of(model, state, world.actions(1)).unsupported.item() == expected


def test_gates_reach_zero_and_one_and_keep_their_gradient():
    logit = torch.tensor([-30.0, -3.0, 0.0, 3.0, 30.0], requires_grad=True)
    value = _gate(logit)
    assert value[[0, 1, 3, 4]].tolist() == [0.0, 0.0, 1.0, 1.0]
    assert value[2].item() == pytest.approx(0.5)
    value.sum().backward()
    assert (logit.grad[1:4] > 0.01).all()


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


# Attention


def test_heads_mix_as_pytorchs_attention_does():
    torch.manual_seed(0)
    block, qkv = Block(32, 4, 2), torch.randn(5, 6, 96)
    q, k, v = qkv.unflatten(-1, (3, 4, 8)).permute(2, 0, 3, 1, 4)
    expected = torch.nn.functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
    torch.testing.assert_close(block._mixed(qkv, None), expected)
    assert block._mixed(1e4 * qkv, None).isfinite().all()


def test_a_block_asked_for_some_tokens_gives_the_same():
    torch.manual_seed(0)
    block, tokens = Block(32, 4, 2), torch.randn(5, 6, 32)
    torch.testing.assert_close(block(tokens, read=4), block(tokens)[:, :4])


@torch.no_grad()
def test_half_of_a_movers_points_are_those_nearest_to_what_may_touch_it(worlds):
    world = replace(worlds["cube"], points=64)
    model = world.model(points=8, searched=64)
    state = model.prepare(world.state(2))
    plan, poses = model.plan(state.layout), state.frames
    shapes = model._shapes(state, plan, poses, poses[:, 0, : plan.links])
    mover = state.layout.entities[plan.places[0]]
    cloud = state.clouds[:, mover.slice]
    read = shapes.points[:, plan.places[0], :3].transpose(-1, -2)  # (B, 8, 3)
    torch.testing.assert_close(read[:, :4], cloud[:, :4])
    gaps = _gaps_to_links(state, plan, cloud, shapes)  # (B, 64)
    nearest = gaps.topk(4, largest=False).values
    torch.testing.assert_close(_gaps_to_links(state, plan, read[:, 4:], shapes).sort().values, nearest)
    assert (shapes.low[:, plan.places[0]] == cloud.amin(1)).all()  # the box is of all that is searched
    few = world.model(points=8, searched=0)
    torch.testing.assert_close(few._shapes(state, plan, poses, poses[:, 0]).points[:, -1, :3], cloud[:, :8].mT)


def _gaps_to_links(state, plan, points, shapes):
    """Largest excess over the nearest link's box (B, n) of a mover's canonical points (B, n, 3), one step ahead."""
    mover = plan.places[0]
    ahead = 2 * state.frames[:, 0, mover] - state.frames[:, 1, mover]
    world = points @ ahead[:, :3, :3].mT + ahead[:, None, :3, 3]
    found = []
    for k in range(plan.links):
        link = state.frames[:, 0, k]
        local = (world - link[:, None, :3, 3]) @ link[:, :3, :3]
        low, high = shapes.low[:, k, None], shapes.high[:, k, None]
        found.append(torch.maximum(low - local, local - high).amax(-1))
    return torch.stack(found).amin(0)
